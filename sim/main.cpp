// SPDX-License-Identifier: Apache-2.0
// `lithe-sim`: offers the simulated devices of a robot file to other programs.
#include <poll.h>
#include <sched.h>
#include <sys/prctl.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <csignal>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "sim/world.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/core/host/realtime.hpp"
#include "spine/core/time.hpp"
#include "spine/hal/physics/truth.hpp"
#include "spine/robot/cores/cpu_plan.hpp"
#include "spine/robot/robot.hpp"

namespace {

using namespace lithe;
using Json = nlohmann::json;

constexpr std::int64_t kTickNs = 1'000'000;

void say(const std::string& line) {
  std::printf("%s\n", line.c_str());
  std::fflush(stdout);
}

constexpr int kRefused = 1, kUsage = 2;  // exit codes, as of `lithe`

int refuse(const std::string& why, int code = kRefused) {
  std::fprintf(stderr, "lithe sim: %s\n", why.c_str());
  return code;
}

Result<> handle_order(const std::string& line, simulator::World& world, std::int64_t now_ns) {
  const Result<simulator::FaultRequest> order = simulator::parse_order(line);
  return order ? world.handle(*order, now_ns) : Result<>(order.error());
}

// Reads orders from stdin until its end.
class Orders {
 public:
  int poll_fd() const { return fd_; }

  void read(simulator::World& world, std::int64_t now_ns) {
    std::array<char, 4096> bytes{};
    const ssize_t count = ::read(fd_, bytes.data(), bytes.size());
    if (count <= 0) fd_ = -1;  // stdin is closed; the devices stay
    for (ssize_t i = 0; i < count; ++i) {
      if (bytes[static_cast<std::size_t>(i)] == '\n') {
        handle(world, now_ns);
        line_.clear();
      } else if (line_.size() < kLongestLine) {
        line_ += bytes[static_cast<std::size_t>(i)];
      }
    }
  }

 private:
  static constexpr std::size_t kLongestLine = 4096;  // a longer line is not an order

  void handle(simulator::World& world, std::int64_t now_ns) {
    if (line_.find_first_not_of(" \r\t") == std::string::npos) return;
    const Result<> did = handle_order(line_, world, now_ns);
    say(did ? Json{{"ok", true}}.dump() : Json{{"ok", false}, {"error", did.message()}}.dump());
  }

  int fd_ = STDIN_FILENO;
  std::string line_;
};

int serve(simulator::World& world, int signals) {
  Orders orders;
  std::int64_t next_tick_ns = monotonic_ns();
  std::vector<pollfd> waits;
  while (true) {
    waits = {{signals, POLLIN, 0}, {orders.poll_fd(), POLLIN, 0}};
    for (const auto& end : world.ends()) {
      const short events = static_cast<short>(POLLIN | (end->wants_to_write() ? POLLOUT : 0));
      waits.push_back({end->poll_fd(), events, 0});
    }
    const std::int64_t wait_ns = std::max<std::int64_t>(next_tick_ns - monotonic_ns(), 0);
    const timespec timeout{0, static_cast<long>(wait_ns)};
    if (::ppoll(waits.data(), waits.size(), &timeout, nullptr) < 0) continue;
    const std::int64_t now_ns = monotonic_ns();
    if (waits[0].revents != 0) return 0;
    if (waits[1].revents != 0) orders.read(world, now_ns);
    for (std::size_t i = 0; i < world.ends().size(); ++i) {
      // An order may have unplugged it in between.
      if (waits[i + 2].revents != 0 && world.ends()[i]->poll_fd() >= 0) world.ends()[i]->serve(now_ns);
    }
    if (now_ns < next_tick_ns) continue;
    world.tick(now_ns);
    next_tick_ns = std::max(next_tick_ns + kTickNs, now_ns);  // missed ticks are not repeated
  }
}

// Keeps off the cores of a Spine on this machine: it spins there with high priority, so we would answer late. If this
// is not possible, the kernel decides.
void keep_off_the_spines_cores(const robot::SpineConfig& wanted) {
  const robot::CpuPlan plan = robot::fold_cpus(machine_cores(), wanted);
  cpu_set_t ours;
  CPU_ZERO(&ours);
  CPU_SET(plan.housekeeping, &ours);
  CPU_SET(plan.brain, &ours);
  ::sched_setaffinity(0, sizeof ours, &ours);
  raise_priority();
}

// The random values drawn from each joint's seed, and whether its drive follows targets, as one line of JSON.
int tell_truth(const std::string& path) {
  const Result<robot::RobotConfig> config = robot::load_robot(path);
  if (!config) return refuse(config.message(), kUsage);
  Json joints = Json::array();
  for (const robot::JointConfig& joint : config->joints) {
    const hal::sim::Truth truth = hal::sim::draw_truth(*config, joint);
    joints.push_back({{"name", joint.name},
                      {"torque_gain", truth.drive.torque_gain},
                      {"encoder_offset_rad", truth.drive.encoder_offset_rad},
                      {"payload_kg", truth.payload_kg},
                      {"inertia_kg_m2", truth.plant.inertia_kg_m2},
                      {"mgl_nm", truth.plant.mgl_nm},
                      {"mgl_told_nm", truth.mgl_told_nm},
                      {"closes_loop", robot::closes_loop(config->devices[joint.device])}});
  }
  say(Json{{"robot", config->name}, {"ideal", config->plant.ideal}, {"joints", joints}}.dump());
  return 0;
}

int run(const std::string& path, const simulator::Options& options, const std::vector<std::string>& faults) {
  sigset_t ends;
  sigemptyset(&ends);
  sigaddset(&ends, SIGINT);
  sigaddset(&ends, SIGTERM);
  ::sigprocmask(SIG_BLOCK, &ends, nullptr);
  const hal::Descriptor signals(::signalfd(-1, &ends, SFD_CLOEXEC));
  ::prctl(PR_SET_TIMERSLACK, 50'000UL, 0UL, 0UL, 0UL);
  const Result<robot::RobotConfig> config = robot::load_robot(path);
  if (!config) return refuse(config.message(), kUsage);
  keep_off_the_spines_cores(config->spine);
  auto world = simulator::World::open(*config, options, say);
  if (!world) return refuse(world.message());
  for (const std::string& fault : faults) {
    const Result<> did = handle_order(fault, **world, monotonic_ns());
    if (!did) return refuse("--fault " + fault + ": " + did.message(), kUsage);
  }
  return serve(**world, signals.get());
}

}  // namespace

int main(int argc, char** argv) {
  try {
    CLI::App app{"simulated devices of a robot file, on pseudo terminals and CAN interfaces, until Ctrl-C",
                 "lithe sim"};
    std::string path;
    simulator::Options options;
    std::vector<std::string> faults;
    app.add_option("ROBOT", path, "robot file")->required();
    app.add_option("--link", options.link_folder, "make links BUS -> terminal in this folder")->type_name("DIR");
    app.add_option("--fault", faults, "a fault from the start, as JSON; as often as you like")
        ->type_name("JSON")
        ->allow_extra_args(false);
    app.add_option("--seed", options.seed, "of the faults that come to frames by chance")->type_name("N");
    bool truth = false;
    app.add_flag(
        "--truth", truth,
        "only print, as JSON, what each simulated joint really is: what its seed drew, and mgl_nm, the gravity "
        "torque, also as the drive would tell it (mgl_told_nm)");
    app.footer(
        "Prints a line for each bus: name, kind, path. Faults also come as JSON lines on the standard input,\n"
        "each answered by a line: {\"fault\": \"drop\", \"share\": 0.1}; docs/reference/sim.md has them all.");
    try {
      app.parse(argc, argv);
    } catch (const CLI::ParseError& wrong) {
      return app.exit(wrong) == 0 ? 0 : kUsage;
    }
    return truth ? tell_truth(path) : run(path, options, faults);
  } catch (const std::exception& wrong) {
    return refuse(wrong.what());
  }
}
