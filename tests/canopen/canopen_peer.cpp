// SPDX-License-Identifier: Apache-2.0
// Our CiA 402 driver for tests/system/drives/test_canopen_interop.py: one drive behind an slcan adapter, driven as a
// robot drives it.   canopen_peer DEVICE NODE torque|position|velocity
// Orders are lines on the standard input: "off", "damp", "torque NM", "position RAD", "velocity RAD_S"; its end is the
// end. A line of JSON every 20 exchanges tells how the joint is.
#include <poll.h>
#include <time.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <memory>
#include <sstream>
#include <string>
#include <utility>

#include "spine/core/time.hpp"
#include "spine/hal/bus/slcan/slcan_bus.hpp"
#include "spine/hal/bus_actuators.hpp"
#include "spine/hal/canopen/canopen_master.hpp"
#include "spine/hal/cia402/cia402_drive.hpp"
#include "spine/wire/wire.hpp"

namespace lithe {
namespace {

constexpr std::int64_t kPeriodNs = 5'000'000;  // the other side is Python
constexpr std::uint64_t kTellEvery = 20;

hal::cia402::Mode mode_named(const std::string& name) {
  if (name == "position") return hal::cia402::Mode::position;
  return name == "velocity" ? hal::cia402::Mode::velocity : hal::cia402::Mode::torque;
}

// Lines of the standard input, without ever waiting for one.
class Orders {
 public:
  // The next line, if there is one; false at the end.
  bool next(std::string& line) {
    line.clear();
    pollfd input{STDIN_FILENO, POLLIN, 0};
    if (text_.find('\n') == std::string::npos && poll(&input, 1, 0) > 0) {
      std::array<char, 256> bytes{};
      const ssize_t count = read(STDIN_FILENO, bytes.data(), bytes.size());
      if (count <= 0) return false;
      text_.append(bytes.data(), static_cast<std::size_t>(count));
    }
    const std::size_t end = text_.find('\n');
    if (end == std::string::npos) return true;
    line = text_.substr(0, end);
    text_.erase(0, end + 1);
    return true;
  }

 private:
  std::string text_;
};

void obey(const std::string& line, hal::ActuatorCommand& command) {
  std::istringstream words(line);
  std::string verb;
  double value = 0;
  words >> verb >> value;
  command.act(verb == "off"    ? hal::DriveAction::off
              : verb == "damp" ? hal::DriveAction::damp
                               : hal::DriveAction::torque);
  command.torque_nm[0] = verb == "torque" ? value : 0;
  command.position_rad[0] = verb == "position" ? value : kNoTarget;
  command.velocity_rad_s[0] = verb == "velocity" ? value : 0;
}

void tell(const hal::ActuatorState& state, const hal::ReplyCounters& counters, const std::string& why) {
  const std::uint32_t status = state.status[0];
  const auto has = [status](std::uint32_t bit) { return (status & bit) != 0 ? "true" : "false"; };
  std::printf(
      "{\"fresh\": %s, \"fault\": %s, \"watchdog\": %s, \"state\": %u, \"fault_class\": %u, \"position_rad\": %.6f, "
      "\"velocity_rad_s\": %.6f, \"torque_nm\": %.6f, \"missed\": %llu, \"malformed\": %llu, \"why\": \"%s\"}\n",
      has(wire::joint_status::kFresh), has(wire::joint_status::kFault), has(wire::joint_status::kWatchdog),
      status >> 16 & 0xff, status >> 8 & 0xff, state.position_rad[0], state.velocity_rad_s[0], state.torque_nm[0],
      static_cast<unsigned long long>(counters.missed), static_cast<unsigned long long>(counters.malformed),
      why.c_str());
  std::fflush(stdout);
}

int drive(const std::string& path, std::uint32_t node, const std::string& mode) {
  auto opened = hal::SlcanBus::open({.path = path, .reply_wait_ns = 3'000'000});
  if (!opened) {
    std::fprintf(stderr, "canopen_peer: %s\n", opened.message().c_str());
    return 1;
  }
  hal::BusActuators actuators(RawClock::calibrate());
  actuators.add_bus(std::move(*opened), hal::canopen::sender_of,
                    std::make_unique<hal::canopen::CanopenMaster>(hal::canopen::MasterParams{.heartbeat_s = 0.1}));
  hal::cia402::DriverParams params;
  params.id = node;
  params.watchdog_s = 1.0;
  params.heartbeat_s = 1.0;  // as lost_after_misses below
  params.period_s = 1e-9 * static_cast<double>(kPeriodNs);
  params.mode = mode_named(mode);
  params.counts_per_rev = 4096;
  params.rated_torque_nm = 0.5;
  params.torque_max_nm = 5;
  params.joint = {-1.0, 0.5, 10.0};
  params.lost_after_misses = 4000;  // as long as a test waits: Python takes its time on a busy machine
  auto driver = std::make_unique<hal::cia402::Cia402Drive>(params);
  const hal::cia402::Cia402Drive& drive = *driver;
  actuators.add_joint(0, node, std::move(driver));

  hal::ActuatorCommand command;
  hal::ActuatorState state;
  command.joints = 1;
  command.max_torque_nm[0] = 5;
  std::int64_t next_ns = monotonic_ns();
  Orders orders;
  for (std::string line; orders.next(line);) {
    if (!line.empty()) obey(line, command);
    ++command.tick;
    actuators.cycle(command, state, monotonic_ns());
    if (command.tick % kTellEvery == 0) tell(state, actuators.counters(), drive.why_not_ready());
    next_ns += kPeriodNs;
    const timespec until{next_ns / 1'000'000'000, next_ns % 1'000'000'000};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr);
  }
  return 0;
}

}  // namespace
}  // namespace lithe

int main(int argc, char** argv) {
  if (argc != 4) {
    std::fprintf(stderr, "usage: canopen_peer DEVICE NODE torque|position|velocity\n");
    return 1;
  }
  return lithe::drive(argv[1], static_cast<std::uint32_t>(std::stoul(argv[2])), argv[3]);
}
