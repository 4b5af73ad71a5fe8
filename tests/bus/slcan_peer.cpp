// SPDX-License-Identifier: Apache-2.0
// Our two ends of slcan, for clients that are not ours. On either of them a frame is answered by the same frame with
// its id one higher.
//   slcan_peer adapter       a simulated adapter between standard input and standard output, until the input ends
//   slcan_peer host DEVICE   our bus on a serial device, until standard input ends
#include <poll.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <string>
#include <string_view>

#include "spine/hal/bus/slcan/sim_slcan.hpp"
#include "spine/hal/bus/slcan/slcan_bus.hpp"

namespace lithe::hal {
namespace {

class Echo final : public BusNode {
 public:
  void on_frame(const Frame& frame, std::int64_t /*now_ns*/, FrameQueue& answers) LITHE_RT override {
    Frame answer = frame;
    ++answer.id;
    answers.push(answer);
  }
};

int adapter() {
  Echo node;
  sim::SimSlcan adapter;
  adapter.attach(node);
  std::array<char, 512> bytes{};
  for (ssize_t size = 0; (size = read(STDIN_FILENO, bytes.data(), bytes.size())) > 0;) {
    std::string out;
    adapter.feed(std::span(bytes).first(static_cast<std::size_t>(size)), 0, out);
    for (std::string_view rest = out; !rest.empty();) {
      const ssize_t taken = write(STDOUT_FILENO, rest.data(), rest.size());
      if (taken < 0) return 1;
      rest.remove_prefix(static_cast<std::size_t>(taken));
    }
  }
  return 0;
}

int host(const char* device) {
  const auto bus = SlcanBus::open({.path = device, .data_bitrate = 5'000'000});
  if (!bus) {
    std::fprintf(stderr, "%s\n", bus.message().c_str());
    return 1;
  }
  pollfd input{STDIN_FILENO, POLLIN, 0};
  while (poll(&input, 1, 1) == 0) {
    (*bus)->begin(0);
    for (Frame frame; (*bus)->receive(frame);) {
      ++frame.id;
      (*bus)->send(frame);
    }
    (*bus)->flush();
  }
  const BusStatistics& counted = (*bus)->statistics();
  std::printf("received %lu sent %lu malformed %lu\n", counted.received, counted.sent, counted.malformed);
  return 0;
}

}  // namespace
}  // namespace lithe::hal

int main(int argc, char** argv) {
  const std::string_view role = argc > 1 ? argv[1] : "";
  if (role == "adapter") return lithe::hal::adapter();
  if (role == "host" && argc > 2) return lithe::hal::host(argv[2]);
  std::fprintf(stderr, "slcan_peer adapter | slcan_peer host DEVICE\n");
  return 2;
}
