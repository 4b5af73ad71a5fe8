// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/serial/serial_port.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>

#include "spine/hal/bus/test/pty_rig.hpp"
#include "spine/hal/bus/test/sys_rig.hpp"
#include "spine/hal/core/descriptor.hpp"

namespace lithe::hal {
namespace {

class SerialIdentityTest : public ::testing::Test {
 protected:
  SerialIdentity identity() const { return identify(device.get(), sys.path()); }

  test::TestPty pty;
  test::FakeSys sys;
  Descriptor device{open(pty.path().c_str(), O_RDWR | O_NOCTTY | O_CLOEXEC)};
};

TEST_F(SerialIdentityTest, OfAPseudoTerminalNothingIsKnown) {
  EXPECT_EQ(identity().who, "");
  EXPECT_EQ(identify(device.get()).who, "") << "nor by this machine's own kernel";
  EXPECT_EQ(identify(-1).who, "");
}

TEST_F(SerialIdentityTest, AnAdapterIsKnownByItsSerialNumberWhereverItIsPluggedIn) {
  sys.plug(pty.path(), "0483", "5740", "A1", "1-1");
  const SerialIdentity first = identity();
  EXPECT_EQ(first.who, "0483:5740 A1");
  EXPECT_TRUE(first.fdcanusb);
  sys.plug(pty.path(), "0483", "5740", "A1", "1-2");
  EXPECT_EQ(identity().who, first.who);
  sys.plug(pty.path(), "1209", "2323", "A1");
  EXPECT_TRUE(identity().fdcanusb);
  EXPECT_NE(identity().who, first.who);
}

TEST_F(SerialIdentityTest, OneWithoutANumberIsKnownByItsSocket) {
  sys.plug(pty.path(), "1a86", "7523", "", "1-1.4");
  EXPECT_EQ(identity().who, "1a86:7523 in socket 1-1.4");
  EXPECT_FALSE(identity().fdcanusb);
}

TEST_F(SerialIdentityTest, AUartOfTheBoardIsKnownByItsPlace) {
  sys.solder(pty.path());
  EXPECT_TRUE(identity().who.ends_with("/devices/platform/fe201000.serial")) << identity().who;
  EXPECT_FALSE(identity().fdcanusb);
}

}  // namespace
}  // namespace lithe::hal
