// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/serial/serial_port.hpp"

#include <fcntl.h>
#include <linux/serial.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "spine/core/text.hpp"

namespace lithe::hal {
namespace {

std::string advice(int error) {
  if (error == ENOENT || error == ENXIO || error == ENODEV)
    return "no such device; plug the adapter in, or give another path (ls -l /dev/serial/by-id)";
  if (error == EACCES || error == EPERM)
    return "not allowed; add yourself to the device's group (sudo usermod -aG dialout $USER, then log in again)";
  if (error == EBUSY || error == EWOULDBLOCK)
    return "another program uses it; a robot that runs: lithe stop; any other: end it (fuser -v names it)";
  return std::string(std::strerror(error)) + "; unplug the adapter and plug it in again";
}

struct Speed {
  std::uint32_t baud;
  speed_t code;
};
constexpr std::array<Speed, 10> kSpeeds{{{115'200, B115200},
                                         {230'400, B230400},
                                         {460'800, B460800},
                                         {500'000, B500000},
                                         {921'600, B921600},
                                         {1'000'000, B1000000},
                                         {1'500'000, B1500000},
                                         {2'000'000, B2000000},
                                         {3'000'000, B3000000},
                                         {4'000'000, B4000000}}};

// 0: no such baud rate.
speed_t speed_of(std::uint32_t baud) {
  for (const Speed& speed : kSpeeds)
    if (speed.baud == baud) return speed.code;
  return B0;
}

std::string speeds() {
  std::string words;
  for (const Speed& speed : kSpeeds) words += (words.empty() ? "" : ", ") + std::to_string(speed.baud);
  return words;
}

bool make_raw(int fd, speed_t speed) {
  termios settings{};
  if (tcgetattr(fd, &settings) != 0) return false;
  cfmakeraw(&settings);
  settings.c_cflag |= CLOCAL | CREAD;
  settings.c_cflag &= ~static_cast<tcflag_t>(CRTSCTS | CSTOPB);
  settings.c_cc[VMIN] = 1;  // with 0, a read without data looks like end of file
  settings.c_cc[VTIME] = 0;
  cfsetspeed(&settings, speed);
  return tcsetattr(fd, TCSANOW, &settings) == 0;
}

// Some drivers collect bytes for 16 ms before they deliver them. Drivers without this option refuse the call.
void ask_for_low_latency(int fd) {
  serial_struct serial{};
  if (ioctl(fd, TIOCGSERIAL, &serial) != 0) return;
  serial.flags |= ASYNC_LOW_LATENCY;
  ioctl(fd, TIOCSSERIAL, &serial);
}

namespace fs = std::filesystem;

// The first line; empty when there is none.
std::string line_of(const fs::path& file) {
  std::ifstream in(file);
  std::string line;
  std::getline(in, line);
  return printable(line);  // the adapter's text may have any bytes
}

}  // namespace

SerialIdentity identify(int fd, const std::string& sys) {
  struct stat node{};
  if (fstat(fd, &node) != 0) return {};
  const std::string number = std::to_string(major(node.st_rdev)) + ":" + std::to_string(minor(node.st_rdev));
  std::error_code none;
  const fs::path device = fs::canonical(sys + "/dev/char/" + number + "/device", none);
  if (none) return {};
  constexpr int kLevels = 4;  // port, interface, device
  fs::path at = device;
  for (int i = 0; i < kLevels; ++i, at = at.parent_path()) {
    const std::string vendor = line_of(at / "idVendor");
    if (vendor.empty()) continue;
    const std::string usb = vendor + ":" + line_of(at / "idProduct");
    const std::string serial = line_of(at / "serial");
    return {usb + (serial.empty() ? " in socket " + at.filename().string() : " " + serial),
            usb == "0483:5740" || usb == "1209:2323"};
  }
  return {device.string(), false};
}

Result<> SerialPort::open() {
  close();
  const speed_t speed = speed_of(baud_);
  if (speed == B0) return Error{path_ + ": no baud rate of " + std::to_string(baud_) + "; use one of " + speeds()};
  Descriptor opened(::open(path_.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
  if (!opened.is_open()) return Error{path_ + ": " + advice(errno)};
  if (isatty(opened.get()) == 0) return Error{path_ + ": is no serial device; give the path of one, like /dev/ttyACM0"};
  if (flock(opened.get(), LOCK_EX | LOCK_NB) != 0) return Error{path_ + ": " + advice(errno)};
  SerialIdentity found = identify(opened.get(), sys_);
  if (!identity_.who.empty() && found.who != identity_.who) {
    return Error{path_ + ": another adapter is there now (" + found.who + ") than before (" + identity_.who +
                 "); give paths of /dev/serial/by-id, which stay with their adapters, or start again if it is meant"};
  }
  if (!make_raw(opened.get(), speed)) return Error{path_ + ": " + advice(errno)};
  ask_for_low_latency(opened.get());
  tcflush(opened.get(), TCIOFLUSH);
  identity_ = std::move(found);
  descriptor_ = std::move(opened);
  return done();
}

}  // namespace lithe::hal
