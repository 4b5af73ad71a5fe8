// SPDX-License-Identifier: Apache-2.0
#include "host/tune/boot/boot.hpp"

#include <gtest/gtest.h>
#include <zlib.h>

#include <string>

#include "host/tune/boot/test/trees_rig.hpp"

namespace lithe::host {
namespace {

void pack(const FakeRoot& root, const std::string& text) {
  root.write("/proc/config.gz", "");
  const gzFile file = gzopen((root.path() + "/proc/config.gz").c_str(), "wb");
  EXPECT_EQ(gzwrite(file, text.data(), static_cast<unsigned>(text.size())), static_cast<int>(text.size()));
  EXPECT_EQ(gzclose(file), Z_OK);
}

const BootCores kTwo{.isolated = {1, 2}, .tickless = {1}, .housekeeping = 0};

std::string flags(const FakeRoot& root) {
  const Result<KernelFlags> made = flags_for(read_kernel(HostFiles(root.path())), kTwo);
  return made ? text_of(made->flags) : made.message();
}

std::string notes(const FakeRoot& root) {
  const Result<KernelFlags> made = flags_for(read_kernel(HostFiles(root.path())), kTwo);
  std::string all;
  if (made)
    for (const std::string& note : made->notes) all += note + "\n";
  return all;
}

TEST(Kernel, GetsEveryFlagThatItKnows) {
  const FakeRoot root;
  trees::pc(root);
  EXPECT_EQ(flags(root),
            "isolcpus=managed_irq,domain,1-2 nohz_full=1 rcu_nocbs=1-2 irqaffinity=0 nosoftlockup nmi_watchdog=0 "
            "skew_tick=1 tsc=reliable");
  EXPECT_EQ(notes(root), "");
}

TEST(Kernel, TrustsATscOnlyWhenTheProcessorSaysSo) {
  const FakeRoot root;
  trees::pc(root);
  root.write("/proc/cpuinfo", "processor\t: 0\nflags\t\t: fpu tsc constant_tsc rdtscp\n");
  EXPECT_EQ(flags(root).find("tsc="), std::string::npos);
}

TEST(Kernel, GetsNoFlagOfAnOptionThatItLacks) {
  const FakeRoot root;  // Debian for arm64
  trees::kernel(root, "6.1.0-38-arm64",
                "CONFIG_NO_HZ_FULL=y\nCONFIG_CPU_ISOLATION=y\nCONFIG_RCU_NOCB_CPU=y\nCONFIG_TICK_ONESHOT=y\n"
                "CONFIG_SOFTLOCKUP_DETECTOR=y\n# CONFIG_HARDLOCKUP_DETECTOR is not set\n");
  EXPECT_EQ(flags(root),
            "isolcpus=managed_irq,domain,1-2 nohz_full=1 rcu_nocbs=1-2 irqaffinity=0 nosoftlockup skew_tick=1");
  EXPECT_NE(notes(root).find("nmi_watchdog=0 (CONFIG_HARDLOCKUP_DETECTOR)"), std::string::npos) << notes(root);
}

TEST(Kernel, WithoutNoHzFullThereIsNoNohzAnywhere) {
  const FakeRoot root;
  trees::kernel(root, "6.12.34+rpt-rpi-2712", trees::kTickingConfig);
  EXPECT_EQ(flags(root), "isolcpus=managed_irq,domain,1-2 irqaffinity=0");
  EXPECT_NE(notes(root).find("without CONFIG_NO_HZ_FULL"), std::string::npos);
}

TEST(Kernel, OptionsThatCannotBeReadGiveTheSafeFlagsAndANote) {
  const FakeRoot root;
  root.write("/proc/sys/kernel/osrelease", "5.15.148-tegra\n");
  EXPECT_EQ(flags(root), "isolcpus=managed_irq,domain,1-2 irqaffinity=0");
  EXPECT_NE(notes(root).find("`sudo modprobe configs` tells"), std::string::npos) << notes(root);
  root.write("/proc/config.gz", "\x1f\x8b");
  EXPECT_EQ(flags(root), "isolcpus=managed_irq,domain,1-2 irqaffinity=0");
  EXPECT_NE(notes(root).find("/proc/config.gz: is damaged"), std::string::npos) << notes(root);
}

TEST(Kernel, WithoutAFileInBootTellsItsOptionsItself) {
  const FakeRoot root;  // Jetson Linux
  root.write("/proc/sys/kernel/osrelease", "5.15.148-tegra\n");
  pack(root, trees::kTickingConfig);
  EXPECT_EQ(flags(root), "isolcpus=managed_irq,domain,1-2 irqaffinity=0");
  EXPECT_EQ(notes(root),
            "the kernel is built without CONFIG_NO_HZ_FULL: the timer's tick stays on the isolated cores\n");
  pack(root, trees::kDebianConfig);
  EXPECT_NE(flags(root).find("nohz_full=1"), std::string::npos) << flags(root);
}

TEST(Kernel, ThatRunsSaysNothingAboutThoseOfAnImage) {
  const FakeRoot root;
  root.write("/lib/modules/6.1.0-38-amd64/x", "");
  pack(root, trees::kDebianConfig);
  EXPECT_EQ(flags(root).find("nohz_full"), std::string::npos);
}

TEST(Kernel, AnOldOneGetsNoWordThatItDoesNotKnow) {
  const FakeRoot root;  // JetPack 4
  trees::kernel(root, "4.9.337-tegra", trees::kTickingConfig);
  EXPECT_EQ(flags(root), "isolcpus=1-2 irqaffinity=0");
  EXPECT_NE(notes(root).find("since 5.6"), std::string::npos);
}

TEST(Kernel, OfSeveralInAnImageEachMustKnowTheFlag) {
  const FakeRoot root;
  root.write("/boot/config-6.1.0-38-amd64", trees::kDebianConfig);
  EXPECT_NE(flags(root).find("nohz_full=1"), std::string::npos);
  root.write("/boot/config-5.4.0-own", trees::kTickingConfig);
  EXPECT_EQ(flags(root), "isolcpus=1-2 irqaffinity=0");
}

TEST(Kernel, ThatCannotIsolateIsRefused) {
  const FakeRoot root;
  trees::kernel(root, "6.1.0-own", "# CONFIG_CPU_ISOLATION is not set\n");
  EXPECT_NE(flags(root).find("without CONFIG_CPU_ISOLATION"), std::string::npos) << flags(root);
}

}  // namespace
}  // namespace lithe::host
