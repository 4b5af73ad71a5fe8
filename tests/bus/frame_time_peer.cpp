// SPDX-License-Identifier: Apache-2.0
// A line of `id extended fd brs data` (hex, 0 or 1, data as hex or -), a line with the frame as it stands on the wire:
// its bits, then slow and fast bits as counted, at least, at most.
#include <fmt/format.h>

#include <iostream>
#include <sstream>
#include <string>

#include "supervisor/bus/plan/frame_time.hpp"

namespace {

using lithe::hal::Frame;

bool read(const std::string& line, Frame& frame) {
  std::istringstream words(line);
  std::string data;
  if (!(words >> std::hex >> frame.id >> frame.extended >> frame.fd >> frame.brs >> data)) return false;
  if (data == "-") return true;
  for (std::size_t i = 0; i + 1 < data.size() && frame.size < lithe::hal::kMaxPayload; i += 2)
    frame.data[frame.size++] = static_cast<std::uint8_t>(std::stoi(data.substr(i, 2), nullptr, 16));
  return true;
}

}  // namespace

int main() {
  std::string line;
  while (std::getline(std::cin, line)) {
    Frame frame;
    if (!read(line, frame)) return 2;
    const lithe::hal::FrameImage image(frame);
    const auto exact = image.count();
    const auto least = lithe::hal::least_bits(lithe::hal::shape_of(frame));
    const auto most = lithe::hal::most_bits(lithe::hal::shape_of(frame));
    std::string levels;
    for (const std::uint8_t level : image.bits()) levels += level != 0 ? '1' : '0';
    std::cout << fmt::format("{} {} {} {} {} {} {}\n", levels, exact.nominal, exact.data, least.nominal, least.data,
                             most.nominal, most.data);
  }
  return 0;
}
