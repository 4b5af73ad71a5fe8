// SPDX-License-Identifier: Apache-2.0
#include "host/read/files.hpp"

#include <gtest/gtest.h>

#include <cerrno>

#include "host/test/root_rig.hpp"

namespace lithe::host {
namespace {

TEST(HostFiles, ReadsBelowItsRootAndTellsThePathWithoutIt) {
  const FakeRoot root;
  root.write("/sys/devices/system/cpu/isolated", "1-3\n");
  const Reading reading = HostFiles(root.path()).read("/sys/devices/system/cpu/isolated");
  EXPECT_TRUE(reading.known());
  EXPECT_EQ(reading.value, "1-3");
  EXPECT_EQ(reading.path, "/sys/devices/system/cpu/isolated");
}

TEST(HostFiles, AnAbsentFileIsAbsentAndNotKnown) {
  const FakeRoot root;
  const Reading reading = HostFiles(root.path()).read("/sys/kernel/mm/ksm/run");
  EXPECT_FALSE(reading.known());
  EXPECT_TRUE(reading.is_absent());
}

TEST(HostFiles, AFolderIsNotAFile) {
  const FakeRoot root;
  root.write("/proc/irq/1/x", "");
  const Reading reading = HostFiles(root.path()).read("/proc/irq/1");
  EXPECT_EQ(reading.error, EISDIR);
  EXPECT_FALSE(reading.is_absent());
}

TEST(HostFiles, AnEmptyFileIsKnown) {
  const FakeRoot root;
  root.write("/sys/devices/system/cpu/isolated", "\n");
  const Reading reading = HostFiles(root.path()).read("/sys/devices/system/cpu/isolated");
  EXPECT_TRUE(reading.known());
  EXPECT_EQ(reading.value, "");
}

TEST(HostFiles, ListsAFolderInOrder) {
  const FakeRoot root;
  root.write("/proc/irq/9/smp_affinity_list", "0");
  root.write("/proc/irq/10/smp_affinity_list", "0");
  EXPECT_EQ(HostFiles(root.path()).list("/proc/irq"), (std::vector<std::string>{"10", "9"}));
  EXPECT_TRUE(HostFiles(root.path()).list("/proc/none").empty());
}

}  // namespace
}  // namespace lithe::host
