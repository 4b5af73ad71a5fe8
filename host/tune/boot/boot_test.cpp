// SPDX-License-Identifier: Apache-2.0
#include "host/tune/boot/boot.hpp"

#include <gtest/gtest.h>
#include <sys/mount.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "host/tune/boot/edit.hpp"
#include "host/tune/boot/test/trees_rig.hpp"
#include "spine/core/host/child.hpp"

namespace lithe::host {
namespace {

const BootCores kFourCores{.isolated = {1, 3}, .tickless = {1}, .housekeeping = 0};
const std::string kPcFlags =
    "isolcpus=managed_irq,domain,1,3 nohz_full=1 rcu_nocbs=1,3 irqaffinity=0 nosoftlockup nmi_watchdog=0 skew_tick=1 "
    "tsc=reliable";
const std::string kSafeFlags = "isolcpus=managed_irq,domain,1,3 irqaffinity=0";
const std::string kOurLines =
    "# lithe tune: isolated cores; `lithe tune revert` removes these lines\n"
    "GRUB_CMDLINE_LINUX=\"$GRUB_CMDLINE_LINUX " +
    kPcFlags + "\"\n# lithe tune: end\n";

class BootTest : public ::testing::Test {
 protected:
  Result<BootPlan> plan(bool image = false) const { return boot_plan(HostFiles(root_.path(), image), kFourCores); }

  // What the plan refuses with; empty: it does not refuse.
  std::string refusal() const {
    const Result<BootPlan> made = plan();
    return made ? "" : made.message();
  }

  std::string bytes(const std::string& path) const {
    std::ifstream file(root_.path() + path, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
  }

  bool exists(const std::string& path) const { return std::filesystem::exists(root_.path() + path); }

  // Plans, makes the one change, plans again (nothing is left to do), and undoes it, to the byte.
  void expect_change(const std::string& board, const std::string& path, const std::string& after) const {
    const bool was_there = exists(path);
    const std::string original = bytes(path);
    const Result<BootPlan> made = plan();
    ASSERT_TRUE(made) << made.message();
    EXPECT_EQ(made->board, board);
    ASSERT_EQ(made->changes.size(), 1U);
    const Change& change = made->changes.front();
    EXPECT_EQ(change.kind, ChangeKind::file);
    EXPECT_EQ(change.path, path);
    EXPECT_EQ(change.was_absent, !was_there);
    EXPECT_EQ(change.before, original);
    EXPECT_EQ(change.after, after);
    EXPECT_TRUE(change.reboot);
    EXPECT_EQ(bytes(path), original);  // planning writes nothing

    root_.write(path, change.after);
    const Result<BootPlan> again = plan();
    ASSERT_TRUE(again) << again.message();
    EXPECT_TRUE(again->changes.empty());
    EXPECT_TRUE(again->commands.empty());

    if (change.was_absent)
      std::filesystem::remove(root_.path() + path);
    else
      root_.write(path, change.before);
    EXPECT_EQ(exists(path), was_there);
    EXPECT_EQ(bytes(path), original);
  }

  const FakeRoot root_;
};

std::string with(std::string text, const std::string& old, const std::string& by) {
  const std::size_t at = text.find(old);
  EXPECT_NE(at, std::string::npos) << old;
  return at == std::string::npos ? text : text.replace(at, old.size(), by);
}

bool says(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

TEST_F(BootTest, Debian12GetsLinesAtTheEndOfItsFile) {
  trees::debian12(root_);
  expect_change("x86", "/etc/default/grub", trees::kDebian12Grub + kOurLines);
  EXPECT_EQ(plan()->commands, std::vector<std::string>{"update-grub"});
}

TEST_F(BootTest, Ubuntu2404GetsAFileOfItsOwn) {
  trees::ubuntu2404(root_);
  expect_change("x86", kOurGrubFile, kOurLines);
}

TEST_F(BootTest, RaspberryPiOsBookwormGetsTheFlagsThatItsKernelKnows) {
  trees::pi5_bookworm(root_);
  expect_change("pi5", "/boot/firmware/cmdline.txt", with(trees::kPiBookworm, "regdom=GB", "regdom=GB " + kSafeFlags));
  EXPECT_EQ(plan()->commands, std::vector<std::string>{});
}

TEST_F(BootTest, OlderRaspberryPiOsHasItsFileElsewhere) {
  trees::pi4_bullseye(root_);
  expect_change("pi4", "/boot/cmdline.txt", with(trees::kPiBullseye, "rootwait", "rootwait " + kSafeFlags));
}

TEST_F(BootTest, JetsonGetsThemOnTheDefaultLabelAlone) {
  trees::jetson(root_, "5.10.104-tegra", trees::kJetPack5);
  expect_change("jetson_orin", "/boot/extlinux/extlinux.conf",
                with(trees::kJetPack5, "console=tty0\n", "console=tty0 " + kSafeFlags + "\n"));
}

TEST_F(BootTest, JetPack6HasLongerLinesAndItsBackupInComments) {
  trees::jetson(root_, "5.15.148-tegra", trees::kJetPack6);
  expect_change("jetson_orin", "/boot/extlinux/extlinux.conf",
                with(trees::kJetPack6, "nospectre_bhb\n", "nospectre_bhb " + kSafeFlags + "\n"));
}

TEST_F(BootTest, SystemdBootHasOneLine) {
  trees::pc(root_);
  root_.write("/etc/kernel/cmdline", "root=UUID=1234 ro quiet");
  expect_change("x86", "/etc/kernel/cmdline", "root=UUID=1234 ro quiet " + kPcFlags);
  EXPECT_EQ(plan()->commands, std::vector<std::string>{"kernel-install add-all"});
}

TEST_F(BootTest, TheCommandIsToldAgainUntilTheMachineIsBootedWithTheFlags) {
  trees::pc(root_);
  root_.write("/etc/kernel/cmdline", "root=UUID=1234 ro quiet " + kPcFlags);
  root_.write("/proc/cmdline", "root=UUID=1234 ro quiet\n");
  EXPECT_TRUE(plan()->changes.empty());
  EXPECT_EQ(plan()->commands, std::vector<std::string>{"kernel-install add-all"});
  root_.write("/proc/cmdline", "root=UUID=1234 ro quiet " + kPcFlags + "\n");
  EXPECT_TRUE(plan()->commands.empty());
}

TEST_F(BootTest, AVirtualMachineIsOneWithTheSameFiles) {
  trees::debian12(root_);
  root_.write("/proc/cpuinfo", "processor\t: 0\nflags\t\t: fpu constant_tsc hypervisor nonstop_tsc\n");
  expect_change("vm", "/etc/default/grub", trees::kDebian12Grub + kOurLines);
}

TEST_F(BootTest, TheCommandsOfAnImageRunWithinIt) {
  trees::debian12(root_);
  EXPECT_EQ(plan(true)->commands, std::vector<std::string>{"chroot " + root_.path() + " update-grub"});
  EXPECT_EQ(boot_commands(HostFiles(root_.path(), true)), plan(true)->commands);
}

// /proc and /sys are mounted in it, for chroot.
TEST_F(BootTest, AnImageIsNotTakenForTheMachineThatMountedIt) {
  trees::debian12(root_);
  const Result<BootPlan> before = plan(true);
  root_.write("/proc/cpuinfo", "processor\t: 0\nflags\t\t: fpu constant_tsc hypervisor nonstop_tsc\n");
  root_.write("/proc/sys/kernel/osrelease", "4.9.0\n");
  root_.write("/proc/device-tree/model", "Raspberry Pi 5 Model B\n");
  root_.write("/proc/cmdline", "quiet\n");
  const Result<BootPlan> after = plan(true);
  ASSERT_TRUE(before && after) << after.message();
  EXPECT_EQ(after->board, before->board);
  EXPECT_EQ(after->changes.at(0).after, before->changes.at(0).after);
  EXPECT_TRUE(says(refusal(), "pi5")) << "this machine, with the same files: " << refusal();
}

TEST_F(BootTest, AnImageThatDoesNotRunIsKnownByItsFiles) {
  root_.write("/boot/config-6.12.34+rpt-rpi-v8", trees::kTickingConfig);
  root_.write("/boot/config-6.12.34+rpt-rpi-2712", trees::kTickingConfig);
  root_.write("/boot/firmware/cmdline.txt", trees::kPiBookworm);
  expect_change("pi4", "/boot/firmware/cmdline.txt", with(trees::kPiBookworm, "regdom=GB", "regdom=GB " + kSafeFlags));
  const std::vector<std::string> notes = plan()->notes;
  EXPECT_TRUE(std::any_of(notes.begin(), notes.end(),
                          [](const std::string& note) { return says(note, "taken for board pi4 because"); }));
  EXPECT_TRUE(plan()->commands.empty()) << "a Pi reads its file at each boot";
}

TEST_F(BootTest, FedoraIsUnknownAndGetsTheLineToAddByHand) {
  trees::kernel(root_, "6.14.0-63.fc42.x86_64", trees::kDebianConfig);
  root_.write("/etc/default/grub", trees::kFedoraGrub);
  root_.write("/usr/sbin/grubby", "");
  const std::string said = refusal();
  EXPECT_TRUE(says(said, "/etc/default/grub (there, but /etc/debian_version is not")) << said;
  EXPECT_TRUE(says(said, "/etc/kernel/cmdline (not there)")) << said;
  EXPECT_TRUE(says(said, "grubby --update-kernel=ALL --args=\"isolcpus=managed_irq,domain,1,3 nohz_full=1")) << said;
}

TEST_F(BootTest, AnUnknownBoardIsToldWhatWasLookedFor) {
  root_.write("/proc/device-tree/model", std::string("Radxa ROCK 5B") + '\0');
  const std::string said = refusal();
  EXPECT_TRUE(says(said, "unknown board: /proc/device-tree/model is \"Radxa ROCK 5B\"")) << said;
  EXPECT_TRUE(says(said, "/etc/nv_tegra_release")) << said;
  EXPECT_TRUE(says(said, "isolcpus=1,3 irqaffinity=0")) << said;  // its kernel is not known either
}

TEST_F(BootTest, ABootPartitionThatIsNotMountedIsMissed) {
  trees::pi5_bookworm(root_);
  std::filesystem::remove_all(root_.path() + "/boot/firmware");
  std::filesystem::remove(root_.path() + "/boot/cmdline.txt");
  EXPECT_TRUE(says(refusal(),
                   "/boot/firmware/cmdline.txt (not there), /boot/cmdline.txt (not there). If the boot partition "
                   "is not mounted"))
      << refusal();
  root_.write("/boot/cmdline.txt", trees::kPiMoved);
  EXPECT_TRUE(says(refusal(), "/boot/cmdline.txt:2: a second line")) << refusal();
}

TEST_F(BootTest, AFlagWithAnotherValueIsAConflictThatNamesBoth) {
  trees::pi5_bookworm(root_);
  root_.write("/boot/firmware/cmdline.txt", "root=/dev/sda1 isolcpus=3 quiet\n");
  EXPECT_TRUE(says(refusal(),
                   "/boot/firmware/cmdline.txt:1: \"isolcpus=3\" is set there, and this plan needs "
                   "\"isolcpus=managed_irq,domain,1,3\""))
      << refusal();
}

TEST_F(BootTest, AFlagSetInAnotherFileOfGrubIsAConflictThere) {
  trees::ubuntu2404(root_);
  root_.write("/etc/default/grub.d/60_own.cfg",
              "GRUB_CMDLINE_LINUX_DEFAULT=\"$GRUB_CMDLINE_LINUX_DEFAULT nohz-full=2\"\n");
  EXPECT_TRUE(says(refusal(), "/etc/default/grub.d/60_own.cfg:1: \"nohz-full=2\"")) << refusal();
}

TEST_F(BootTest, FlagsOfTheUserAreNotWrittenTwice) {
  trees::ubuntu2404(root_);
  root_.write("/etc/default/grub.d/60_own.cfg", "GRUB_CMDLINE_LINUX='nosoftlockup  skew_tick=1'\n");
  const Result<BootPlan> made = plan();
  ASSERT_TRUE(made) << made.message();
  EXPECT_TRUE(says(made->changes.at(0).after, "irqaffinity=0 nmi_watchdog=0 tsc=reliable\"\n"))
      << made->changes[0].after;
}

TEST_F(BootTest, ALaterFileThatDropsOurFlagsIsRefused) {
  trees::ubuntu2404(root_);
  root_.write("/etc/default/grub.d/zz.cfg", "# own\nGRUB_CMDLINE_LINUX=quiet\n");
  EXPECT_TRUE(says(refusal(), "/etc/default/grub.d/zz.cfg:2: this line drops")) << refusal();
  root_.write("/etc/default/grub.d/zz.cfg", "# own\nGRUB_CMDLINE_LINUX=\"${GRUB_CMDLINE_LINUX} quiet\"\n");
  EXPECT_EQ(refusal(), "");
}

TEST_F(BootTest, OurLinesForOtherCoresAreNotOverwritten) {
  trees::ubuntu2404(root_);
  root_.write(kOurGrubFile, with(kOurLines, "nohz_full=1", "nohz_full=3"));
  EXPECT_TRUE(says(refusal(), "99-lithe.cfg:1: our lines are not those of this plan")) << refusal();
}

TEST_F(BootTest, OurLinesWithoutTheirEndAreHalfEdited) {
  trees::debian12(root_);
  root_.write("/etc/default/grub", trees::kDebian12Grub + with(kOurLines, "# lithe tune: end\n", ""));
  EXPECT_TRUE(says(refusal(), "our lines begin here and do not end")) << refusal();
  root_.write("/etc/default/grub", trees::kDebian12Grub + kOurLines + "# lithe tune: end\n");
  EXPECT_TRUE(says(refusal(), "a line of ours that is not whole")) << refusal();
}

TEST_F(BootTest, AFolderInPlaceOfABootFileIsNamed) {
  trees::pi5_bookworm(root_);
  std::filesystem::remove(root_.path() + "/boot/firmware/cmdline.txt");
  root_.write("/boot/firmware/cmdline.txt/x", "");
  EXPECT_TRUE(says(refusal(), "/boot/firmware/cmdline.txt: is a directory, not a file")) << refusal();
}

TEST_F(BootTest, ALinkIsNotFollowed) {
  trees::pi5_bookworm(root_);
  root_.write("/elsewhere", trees::kPiBookworm);
  std::filesystem::remove(root_.path() + "/boot/firmware/cmdline.txt");
  std::filesystem::create_symlink(root_.path() + "/elsewhere", root_.path() + "/boot/firmware/cmdline.txt");
  EXPECT_TRUE(says(refusal(), "is a symbolic link")) << refusal();
}

TEST_F(BootTest, ABootPartitionMountedReadOnlyIsToldSo) {
  trees::pi5_bookworm(root_);
  const std::string folder = root_.path() + "/boot/firmware";
  constexpr int kNoNamespaces = 77;
  const auto body = [&](int out) {
    if (::unshare(CLONE_NEWUSER | CLONE_NEWNS) != 0) return kNoNamespaces;
    if (::mount(folder.c_str(), folder.c_str(), nullptr, MS_BIND, nullptr) != 0) return kNoNamespaces;
    if (::mount(nullptr, folder.c_str(), nullptr, MS_REMOUNT | MS_BIND | MS_RDONLY, nullptr) != 0) return kNoNamespaces;
    const std::string said = refusal();
    return ::write(out, said.data(), said.size()) < 0 ? 1 : 0;
  };
  const ChildEnd end = run_forked(body, {.wall_ms = 60'000, .output_bytes = 4096});
  if (end.exit_code == kNoNamespaces) GTEST_SKIP() << "this system gives no user namespaces to mount in";
  EXPECT_TRUE(says(end.output, "/boot/firmware/cmdline.txt is on a file system mounted read-only")) << end.output;
}

TEST_F(BootTest, CoresMustMakeSense) {
  trees::debian12(root_);
  const HostFiles files(root_.path());
  EXPECT_FALSE(boot_plan(files, {.isolated = {}, .tickless = {}, .housekeeping = 0}));
  EXPECT_FALSE(boot_plan(files, {.isolated = {0, 1}, .tickless = {1}, .housekeeping = 0}));
  EXPECT_FALSE(boot_plan(files, {.isolated = {1}, .tickless = {2}, .housekeeping = 0}));
  EXPECT_FALSE(boot_plan(files, {.isolated = {-1}, .tickless = {}, .housekeeping = 0}));
  EXPECT_TRUE(boot_plan(files, {.isolated = {1}, .tickless = {}, .housekeeping = 0}));
  const Result<BootPlan> mixed = boot_plan(files, {.isolated = {3, 1, 3}, .tickless = {1}, .housekeeping = 0});
  ASSERT_TRUE(mixed) << mixed.message();
  EXPECT_EQ(mixed->changes.at(0).after, trees::kDebian12Grub + kOurLines);
}

}  // namespace
}  // namespace lithe::host
