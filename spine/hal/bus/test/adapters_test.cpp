// SPDX-License-Identifier: Apache-2.0
// Whole exchanges with drives behind an adapter: our end of a terminal, a simulated adapter at the other one, and what
// can happen to the bytes on their way.
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "spine/core/test/units_rig.hpp"
#include "spine/core/time.hpp"
#include "spine/hal/bus/fdcanusb/fdcanusb_bus.hpp"
#include "spine/hal/bus/fdcanusb/sim_fdcanusb.hpp"
#include "spine/hal/bus/slcan/sim_slcan.hpp"
#include "spine/hal/bus/slcan/slcan_bus.hpp"
#include "spine/hal/bus/test/pty_rig.hpp"
#include "spine/hal/bus_actuators.hpp"
#include "spine/hal/moteus/moteus.hpp"
#include "spine/hal/moteus/sim/sim_moteus.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal {
namespace {

constexpr std::int64_t kLong = 60'000 * kMs;  // nobody waits for it: every answer comes, when its thread is let
constexpr std::uint32_t kDrives = 3;

// An adapter with moteus drives behind it, served by a thread.
class FarEnd {
 public:
  explicit FarEnd(std::unique_ptr<sim::SimAdapter> adapter) : adapter_(std::move(adapter)) {
    for (std::uint32_t id = 1; id <= kDrives; ++id) {
      sim::SimMoteusParams params;
      params.id = id;
      params.plant.initial_position_rad = 0.1 * id;
      drives_.push_back(std::make_unique<sim::SimMoteus>(params));
      adapter_->attach(*drives_.back());
    }
    thread_ = std::thread([this] { serve(); });
  }
  ~FarEnd() {
    over_.store(true, std::memory_order_relaxed);
    thread_.join();
  }
  FarEnd(const FarEnd&) = delete;
  FarEnd& operator=(const FarEnd&) = delete;

  std::string path() const { return pty_.path(); }
  // Pulls the device out and plugs in a new one.
  void replug() {
    replug_.store(true, std::memory_order_release);
    test::await([this] { return !replug_.load(std::memory_order_acquire); });
  }
  void set_bus_off(bool bad) { wires_bad_.store(bad, std::memory_order_release); }
  // It hears the next words so much later: a busy machine starves a thread for as long.
  void stand_still(std::chrono::milliseconds pause) { stands_still_.store(pause, std::memory_order_relaxed); }
  // Every answer of the adapter passes through it from now on.
  // Contract: before the first exchange
  void spoil_with(std::function<void(std::string&)> spoil) {
    spoil_ = std::move(spoil);
    spoils_.store(true, std::memory_order_release);
  }

 private:
  void serve() {
    bool bad = false;
    for (std::int64_t now_ns = kMs; !over_.load(std::memory_order_relaxed); now_ns += kMs / 10) {
      if (bad != wires_bad_.load(std::memory_order_acquire)) adapter_->set_bus_off(bad = !bad);
      if (replug_.load(std::memory_order_acquire)) {
        pty_.unplug();
        adapter_->reset();
        pty_.plug_in();
        replug_.store(false, std::memory_order_release);
      }
      std::this_thread::sleep_for(stands_still_.exchange(std::chrono::milliseconds(0), std::memory_order_relaxed));
      const std::string heard = pty_.heard();
      if (heard.empty()) {
        std::string unasked;
        adapter_->idle(now_ns, unasked);
        if (!unasked.empty()) pty_.say(unasked);
        std::this_thread::sleep_for(std::chrono::microseconds(50));
        continue;
      }
      std::string said;
      adapter_->feed({heard.data(), heard.size()}, now_ns, said);
      if (spoils_.load(std::memory_order_acquire)) spoil_(said);
      pty_.say(said);
    }
  }

  test::TestPty pty_;
  std::unique_ptr<sim::SimAdapter> adapter_;
  std::vector<std::unique_ptr<sim::SimMoteus>> drives_;
  std::function<void(std::string&)> spoil_;
  std::atomic<bool> spoils_{false};
  std::atomic<bool> replug_{false};
  std::atomic<bool> wires_bad_{false};
  std::atomic<std::chrono::milliseconds> stands_still_{std::chrono::milliseconds(0)};
  std::atomic<bool> over_{false};
  std::thread thread_;
};

// Our end: a joint per drive.
struct NearEnd {
  explicit NearEnd(std::unique_ptr<Bus> opened) : bus(opened.get()), actuators(RawClock::calibrate(kMs)) {
    actuators.add_bus(std::move(opened), hal::moteus::device_of);
    for (std::uint32_t id = 1; id <= kDrives; ++id) {
      moteus::DriverParams driver;
      driver.id = id;
      actuators.add_joint(0, id, std::make_unique<moteus::MoteusDrive>(driver));
    }
    command.joints = kDrives;
  }
  void cycle() {
    now_ns += kMs;
    actuators.cycle(command, state, now_ns);
  }
  bool fresh() const {
    bool all = true;
    for (std::size_t i = 0; i < kDrives; ++i) all = all && (state.status[i] & wire::joint_status::kFresh) != 0;
    return all;
  }
  void expect_true_positions() const {
    for (std::size_t i = 0; i < kDrives; ++i) EXPECT_NEAR(state.position_rad[i], 0.1 * double(i + 1), 0.02) << i;
  }

  Bus* bus;
  BusActuators actuators;
  ActuatorCommand command;
  ActuatorState state;
  std::int64_t now_ns = 1'000 * kMs;
};

std::unique_ptr<Bus> fdcanusb(const FarEnd& far, Checksums checksums, std::int64_t wait_ns = kLong) {
  auto bus = FdcanusbBus::open({far.path(), checksums, wait_ns});
  EXPECT_TRUE(bus) << (bus ? "" : bus.message());
  return std::move(*bus);
}

class AdapterWithChecksums : public ::testing::TestWithParam<Checksums> {};

TEST_P(AdapterWithChecksums, EveryDriveAnswersInEveryExchange) {
  FarEnd far(std::make_unique<sim::SimFdcanusb>());
  NearEnd near(fdcanusb(far, GetParam()));
  for (int i = 0; i < 200; ++i) {
    if (i % 40 == 0) far.stand_still(std::chrono::milliseconds(200));
    near.cycle();
  }
  EXPECT_EQ(near.actuators.counters().missed, 0U);
  EXPECT_EQ(near.actuators.counters().stray, 0U);
  EXPECT_EQ(near.bus->statistics().malformed, 0U);
  EXPECT_EQ(near.bus->statistics().received, 200U * kDrives);
  near.expect_true_positions();
}

INSTANTIATE_TEST_SUITE_P(Of, AdapterWithChecksums,
                         ::testing::Values(Checksums::off, Checksums::on, Checksums::automatic));

TEST(Adapter, ThroughSlcanAsWell) {
  FarEnd far(std::make_unique<sim::SimSlcan>());
  auto bus = SlcanBus::open({far.path(), 1'000'000, 5'000'000, kLong});
  ASSERT_TRUE(bus) << bus.message();
  NearEnd near(std::move(*bus));
  for (int i = 0; i < 200; ++i) near.cycle();
  EXPECT_EQ(near.actuators.counters().missed, 0U);
  near.expect_true_positions();
}

TEST(Adapter, PulledOutItCostsTheJointsTheirAnswersButNoTimeAndThenTheyAreBack) {
  FarEnd far(std::make_unique<sim::SimFdcanusb>());
  NearEnd near(fdcanusb(far, Checksums::automatic));
  for (int i = 0; i < 20; ++i) near.cycle();
  ASSERT_TRUE(near.fresh());
  far.replug();
  for (int i = 0; i < 4; ++i) near.cycle();
  for (std::size_t i = 0; i < kDrives; ++i) EXPECT_NE(near.state.status[i] & wire::joint_status::kLost, 0U);
  EXPECT_NE(near.bus->why_down(), "");
  near.bus->service();
  EXPECT_EQ(near.bus->why_down(), "");
  for (int i = 0; i < 20; ++i) near.cycle();
  EXPECT_TRUE(near.fresh());
  EXPECT_EQ(near.bus->statistics().reopened, 1U);
  near.expect_true_positions();
}

// Wires that touch for a moment: the controller gives up, and without being told it would never come back.
void survive_bus_off(FarEnd& far, NearEnd& near) {
  std::uint32_t cycles = 0;
  const auto cycle_until = [&](const auto& fulfilled) {
    return test::await([&] {
      near.cycle();
      if (++cycles % 500 == 0) near.bus->service();
      return fulfilled();
    });
  };
  const auto fresh = [&] { return near.fresh(); };
  ASSERT_TRUE(cycle_until(fresh));
  far.set_bus_off(true);
  EXPECT_TRUE(cycle_until([&] { return near.bus->why_down().find("bus-off") != std::string::npos; }));
  EXPECT_GT(near.bus->statistics().errors, 0U);
  far.set_bus_off(false);
  EXPECT_TRUE(cycle_until(fresh));
  EXPECT_EQ(near.bus->why_down(), "");
  near.expect_true_positions();
}

TEST(Adapter, ABusOffBehindAnFdcanusbIsNamedAndSurvived) {
  FarEnd far(std::make_unique<sim::SimFdcanusb>());
  NearEnd near(fdcanusb(far, Checksums::automatic, 20 * kMs));
  survive_bus_off(far, near);
}

TEST(Adapter, ABusOffBehindAnSlcanIsNamedAndSurvived) {
  FarEnd far(std::make_unique<sim::SimSlcan>());
  auto bus = SlcanBus::open({far.path(), 1'000'000, 5'000'000, 20 * kMs});
  ASSERT_TRUE(bus) << bus.message();
  NearEnd near(std::move(*bus));
  survive_bus_off(far, near);
}

// Every fourth answer comes with one byte changed first, and then as it is: with checksums only the second is believed.
// No exchange has to wait in vain for an answer.
TEST(Adapter, ASpoiltAnswerIsNotBelieved) {
  FarEnd far(std::make_unique<sim::SimFdcanusb>());
  std::mt19937 random(2);
  constexpr std::uint64_t kCycles = 100;
  std::uint64_t lines = 0;
  std::atomic<std::uint64_t> spoilt{0};
  far.spoil_with([&](std::string& said) {
    for (std::size_t at = said.find("rcv "); at != std::string::npos; at = said.find("rcv ", at + 1)) {
      if (++lines % 4 != 0) continue;
      std::string line = said.substr(at, said.find('\n', at) + 1 - at);
      char& byte = line[random() % (line.size() - 2)];  // not of its end
      byte = byte == '7' ? '3' : '7';
      said.insert(at, line);
      at += line.size();
      spoilt.fetch_add(1, std::memory_order_relaxed);
    }
  });
  NearEnd near(fdcanusb(far, Checksums::on));
  for (std::uint64_t i = 0; i < kCycles; ++i) {
    if (i % 20 == 0) far.stand_still(std::chrono::milliseconds(200));
    near.cycle();
  }
  EXPECT_EQ(near.actuators.counters().missed, 0U);
  EXPECT_EQ(near.bus->statistics().received, kCycles * kDrives);
  EXPECT_EQ(near.bus->statistics().malformed, spoilt.load());
  EXPECT_EQ(spoilt.load(), kCycles * kDrives / 4);
  near.expect_true_positions();
}

TEST(Adapter, AnswersThatAreSaidTwiceCountOnce) {
  FarEnd far(std::make_unique<sim::SimFdcanusb>());
  far.spoil_with([](std::string& said) { said += said; });
  NearEnd near(fdcanusb(far, Checksums::off));
  for (int i = 0; i < 100; ++i) near.cycle();
  EXPECT_EQ(near.actuators.counters().missed, 0U);
  const ReplyCounters& counters = near.actuators.counters();
  EXPECT_GT(counters.duplicate + counters.late, 250U) << "the last ones may still be on their way";
  near.expect_true_positions();
}

}  // namespace
}  // namespace lithe::hal
