// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/serial_port.hpp"

#include <fcntl.h>
#include <linux/serial.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

namespace lithe::hal {
namespace {

std::string advice(int error) {
  switch (error) {
    case ENOENT:
    case ENXIO:
    case ENODEV:
      return "no such device; plug the adapter in, or give another path (ls -l /dev/serial/by-id)";
    case EACCES:
    case EPERM:
      return "not allowed; add yourself to the device's group (sudo usermod -aG dialout $USER, then log in again)";
    case EBUSY:
    case EWOULDBLOCK:
      return "another program uses it; end that one (fuser -v names it)";
    default:
      return std::string(std::strerror(error)) + "; unplug the adapter and plug it in again";
  }
}

bool make_raw(int fd) {
  termios settings{};
  if (tcgetattr(fd, &settings) != 0) return false;
  cfmakeraw(&settings);
  settings.c_cflag |= CLOCAL | CREAD;
  settings.c_cflag &= ~static_cast<tcflag_t>(CRTSCTS | CSTOPB);
  settings.c_cc[VMIN] = 1;  // with none, a read that finds nothing looks like the end
  settings.c_cc[VTIME] = 0;
  cfsetspeed(&settings, B921600);
  return tcsetattr(fd, TCSANOW, &settings) == 0;
}

// Some drivers collect bytes for 16 ms before they hand them over. Those that know no such delay say no.
void ask_for_low_latency(int fd) {
  serial_struct serial{};
  if (ioctl(fd, TIOCGSERIAL, &serial) != 0) return;
  serial.flags |= ASYNC_LOW_LATENCY;
  ioctl(fd, TIOCSSERIAL, &serial);
}

}  // namespace

Result<> SerialPort::open() {
  close();
  Descriptor opened(::open(path_.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
  if (!opened.is_open()) return Error{path_ + ": " + advice(errno)};
  if (isatty(opened.get()) == 0) return Error{path_ + ": is no serial device; give the path of one, like /dev/ttyACM0"};
  if (flock(opened.get(), LOCK_EX | LOCK_NB) != 0) return Error{path_ + ": " + advice(errno)};
  if (!make_raw(opened.get())) return Error{path_ + ": " + advice(errno)};
  ask_for_low_latency(opened.get());
  tcflush(opened.get(), TCIOFLUSH);
  descriptor_ = std::move(opened);
  return done();
}

}  // namespace lithe::hal
