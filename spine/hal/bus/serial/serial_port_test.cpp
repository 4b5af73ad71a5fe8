// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/serial/serial_port.hpp"

#include <gtest/gtest.h>
#include <sys/wait.h>

#include <array>
#include <cerrno>

#include "spine/hal/bus/test/pty_rig.hpp"
#include "spine/hal/bus/test/sys_rig.hpp"

namespace lithe::hal {
namespace {

using test::TestPty;

std::string read_until(SerialPort& port, std::size_t size) {
  std::string all;
  std::array<char, 64> part{};
  test::await([&] {
    const Moved moved = port.read(part);
    all.append(part.data(), moved.bytes);
    return all.size() >= size || moved.error != 0;
  });
  return all;
}

// What the fuzzers rely on, which end where they are refuted.
TEST(TestPty, WithoutItsPathItLeavesNothingAndOpensByItsDevice) {
  test::TestPty pty;
  const std::string folder = pty.path().substr(0, pty.path().rfind('/'));
  EXPECT_EQ(access(folder.c_str(), F_OK), 0);
  pty.forget_path();
  EXPECT_NE(access(folder.c_str(), F_OK), 0);
  SerialPort port(pty.device());
  const Result<> opened = port.open();
  EXPECT_TRUE(opened) << opened.message();
}

TEST(SerialPort, CarriesEveryByteAsItIs) {
  TestPty pty;
  SerialPort port(pty.path());
  ASSERT_TRUE(port.open());
  std::string all;
  for (int c = 0; c < 256; ++c) all += static_cast<char>(c);
  EXPECT_EQ(port.write(all).bytes, all.size());
  EXPECT_EQ(pty.heard_until("\xff"), all) << "no byte of its own, none changed";
  pty.say(all);
  EXPECT_EQ(read_until(port, all.size()), all) << "no signal, no line that waits for its end";
  EXPECT_EQ(pty.heard(), "") << "no echo";
}

TEST(SerialPort, NeverWaits) {
  TestPty pty;
  SerialPort port(pty.path());
  ASSERT_TRUE(port.open());
  std::array<char, 16> in{};
  const Moved nothing = port.read(in);
  EXPECT_EQ(nothing.bytes, 0U);
  EXPECT_EQ(nothing.error, 0);
  const std::string much(65536, 'x');
  Moved moved;
  for (int i = 0; i < 100; ++i) moved = port.write(much);
  EXPECT_EQ(moved.error, 0);
  EXPECT_LT(moved.bytes, much.size()) << "nobody reads: it is full, and says so instead of waiting";
}

TEST(SerialPort, TellsThatTheOtherEndIsGoneAndOpensTheNextOne) {
  TestPty pty;
  SerialPort port(pty.path());
  ASSERT_TRUE(port.open());
  pty.unplug();
  std::array<char, 16> in{};
  EXPECT_EQ(port.read(in).error, EIO);
  EXPECT_EQ(port.write(in).error, EIO);
  const Result<> gone = port.open();
  ASSERT_FALSE(gone);
  EXPECT_NE(gone.message().find("plug the adapter in"), std::string::npos) << gone.message();
  EXPECT_EQ(port.read(in).error, EBADF) << "closed, and harmless";
  pty.plug_in();
  ASSERT_TRUE(port.open());
  pty.say("back");
  EXPECT_EQ(read_until(port, 4), "back");
}

// Ids repeat on each bus: with the adapters exchanged every drive would answer, and get another one's commands.
TEST(SerialPort, AnotherAdapterBehindTheSamePathIsRefused) {
  TestPty pty;
  test::FakeSys sys;
  sys.plug(pty.path(), "0483", "5740", "SHOULDER");
  SerialPort port(pty.path(), kUsualBaud, sys.path());
  ASSERT_TRUE(port.open());
  EXPECT_TRUE(port.identity().fdcanusb);
  sys.plug(pty.path(), "0483", "5740", "HAND");
  const Result<> other = port.open();
  ASSERT_FALSE(other);
  EXPECT_NE(other.message().find("0483:5740 HAND"), std::string::npos) << other.message();
  EXPECT_NE(other.message().find("/dev/serial/by-id"), std::string::npos) << other.message();
  sys.plug(pty.path(), "0483", "5740", "SHOULDER", "1-2");
  EXPECT_TRUE(port.open()) << "the same again, in another socket";
}

TEST(SerialPort, RefusesWhatIsNoSerialDevice) {
  for (const char* path : {"/dev/null", "/proc/self/status", "/no/such/device", "/tmp"}) {
    SerialPort port(path);
    const Result<> opened = port.open();
    ASSERT_FALSE(opened) << path;
    EXPECT_TRUE(opened.message().starts_with(path)) << opened.message();
  }
}

TEST(SerialPort, IsOneProgramsAtATime) {
  TestPty pty;
  SerialPort first(pty.path());
  ASSERT_TRUE(first.open());
  EXPECT_TRUE(first.open()) << "again, by the same";
  SerialPort second(pty.path());
  const Result<> opened = second.open();
  ASSERT_FALSE(opened);
  EXPECT_NE(opened.message().find("another program"), std::string::npos) << opened.message();
  first.close();
  EXPECT_TRUE(second.open());
}

// A process without a terminal gets none by opening an adapter: a hang-up there must not end it.
TEST(SerialPort, DoesNotBecomeTheTerminalOfItsProcess) {
  TestPty pty;
  const std::string path = pty.path();
  const pid_t child = fork();
  if (child == 0) {
    setsid();
    SerialPort port(path);
    const bool opened = static_cast<bool>(port.open());
    _exit(opened && open("/dev/tty", O_RDWR) < 0 ? 0 : 1);
  }
  int status = -1;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
}

}  // namespace
}  // namespace lithe::hal
