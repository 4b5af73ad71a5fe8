// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/serial/serial_identity.hpp"

#include <sys/stat.h>
#include <sys/sysmacros.h>

#include <filesystem>
#include <fstream>

#include "spine/core/text.hpp"

namespace lithe::hal {
namespace {

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

}  // namespace lithe::hal
