// SPDX-License-Identifier: Apache-2.0
#include "spine/core/host/interrupts.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

namespace lithe {
namespace {

namespace fs = std::filesystem;

class Interrupts : public ::testing::Test {
 protected:
  ~Interrupts() override { fs::remove_all(root_); }
  void put(const std::string& path, const std::string& text) const {
    fs::create_directories(fs::path(root_ + path).parent_path());
    std::ofstream(root_ + path) << text << '\n';
  }
  void allow(int number, const std::string& allowed, const std::string& effective = "") const {
    const std::string folder = "/proc/irq/" + std::to_string(number);
    put(folder + "/smp_affinity_list", allowed);
    put(folder + "/effective_affinity_list", effective);
  }
  // "24 eth0, 25 i2c": those of a core; or the file that could not be read.
  std::string of(int cpu) const {
    const auto found = interrupts_of(cpu, root_);
    if (!found) return "unknown: " + found.message().substr(root_.size());
    std::string text;
    for (const Interrupt& each : *found)
      text += (text.empty() ? "" : ", ") + std::to_string(each.number) + " " + each.name;
    return text;
  }

  std::string root_ = testing::TempDir() + "lithe_interrupts_" + std::to_string(getpid());
};

// The contents on a PC.
constexpr const char* kPc =
    "            CPU0       CPU1       \n"
    "   4:          0       3055  IO-APIC   4-edge      ttyS0\n"
    "  24:          1          0  PCI-MSIX-0000:00:04.0   0-edge      i2c / a b\n"
    "  25:          0          7  IR-PCI-MSI 524288-edge      eth0-rx, eth0-tx\n"
    " NMI:          0          0   Non-maskable interrupts\n"
    " LOC:   31622301    4722313   Local timer interrupts\n"
    " ERR:          0\n";

TEST_F(Interrupts, AreThoseWhoseMaskHasTheCore) {
  put("/proc/interrupts", kPc);
  allow(4, "0-1");
  allow(24, "0");
  allow(25, "1");
  EXPECT_EQ(of(0), "4 ttyS0, 24 i2c / a b");
  EXPECT_EQ(of(1), "4 ttyS0, 25 eth0-rx, eth0-tx");
}

TEST_F(Interrupts, LandWhereTheKernelSendsThemNotWhereverTheyWereAllowed) {
  put("/proc/interrupts", kPc);
  for (const int number : {4, 24, 25}) allow(number, "0-1", "0");
  EXPECT_EQ(of(1), "");
  fs::remove(root_ + "/proc/irq/24/effective_affinity_list");  // a kernel without this file
  allow(25, "0-1", "");                                        // a controller that leaves it empty
  EXPECT_EQ(of(1), "24 i2c / a b, 25 eth0-rx, eth0-tx");
}

// The contents on a Raspberry Pi 4: the timer of each core is an interrupt with a number.
TEST_F(Interrupts, ThatEachCoreHasForItselfAreNoDevices) {
  put("/proc/interrupts",
      "           CPU0       CPU1       \n"
      " 11:      92511      88211     GICv2  30 Level     arch_timer\n"
      " 23:          5          6    RISC-V INTC   5 Edge      riscv-timer\n"
      " 33:      11327          0     GICv2  65 Level     fe00b880.mailbox\n"
      "IPI0:       812        931       Rescheduling interrupts\n"
      "Err:          0\n");
  for (const int number : {11, 23, 33}) allow(number, "0-1");
  EXPECT_EQ(of(1), "33 fe00b880.mailbox");
}

// The twins: where it is unknown, the answer is not "none".
TEST_F(Interrupts, ThatCannotBeReadAreUnknownNotNone) {
  EXPECT_EQ(of(1), "unknown: /proc/interrupts: No such file or directory");
  put("/proc/interrupts", "");  // in some containers it is empty
  EXPECT_EQ(of(1), "unknown: /proc/interrupts: has no column of a core");
  put("/proc/interrupts", kPc);
  allow(4, "0");
  allow(24, "0");
  EXPECT_EQ(of(1), "unknown: /proc/irq/25/smp_affinity_list: No such file or directory");
  allow(25, "(null)");
  EXPECT_EQ(of(1), "unknown: /proc/irq/25/smp_affinity_list: is no list of cores");
}

TEST_F(Interrupts, AreToldInWords) {
  EXPECT_EQ(interrupt_words(std::vector<Interrupt>{}), "no device interrupt may land there");
  EXPECT_EQ(interrupt_words(std::vector<Interrupt>{{24, "eth0"}}), "1 device interrupt may land there: 24 eth0");
  std::vector<Interrupt> many;
  for (int number = 1; number <= 10; ++number) many.push_back({number, "x"});
  EXPECT_EQ(interrupt_words(many),
            "10 device interrupts may land there: 1 x, 2 x, 3 x, 4 x, 5 x, 6 x, 7 x, 8 x and 2 more");
  EXPECT_EQ(interrupt_words(interrupts_of(1, root_)), "unknown whether device interrupts may land there (" + root_ +
                                                          "/proc/interrupts: No such file or directory)");
}

TEST_F(Interrupts, OfThisMachineAreReadOrUnknown) {
  const auto found = interrupts_of(0);
  if (!found) GTEST_SKIP() << found.message();
  for (const Interrupt& each : *found) EXPECT_FALSE(each.name.empty()) << each.number;
}

}  // namespace
}  // namespace lithe
