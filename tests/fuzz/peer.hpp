// SPDX-License-Identifier: Apache-2.0
// The far end of a bus that cannot be trusted: real simulated devices whose every frame may be dropped, doubled, kept
// back, spoilt, readdressed, exchanged for an old one, or accompanied by what nobody said.
#pragma once

#include <array>
#include <memory>

#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/core/drive.hpp"
#include "spine/hal/gateway/gateway.hpp"
#include "tests/fuzz/fuzz.hpp"

namespace lithe::fuzz {

enum class Trick : std::uint8_t { honest, drop, twice, later, spoil, readdress, old, cut, invent, flood };
inline constexpr std::size_t kTricks = 10;

// A frame, and the exchange in which a device said it; 0: no device did.
struct Said {
  hal::Frame frame;
  std::uint64_t exchange = 0;
};

// Contract: one thread · the tricks of an exchange are given before it
class Peer final : public hal::BusNode {
 public:
  static constexpr std::size_t kMostTricks = 32;
  static constexpr std::size_t kHistory = 256;

  void attach(hal::BusNode& device) {
    if (devices_ < device_.size()) device_[devices_++] = &device;
  }

  // `likely`: ids for invented frames. From here on exchange `number`.
  void plan(Input& input, std::span<const std::uint32_t> likely, std::uint64_t number) {
    exchange_ = number;
    tricks_ = next_trick_ = 0;
    const std::size_t count = input.byte() % (kMostTricks + 1);
    for (; tricks_ < count && !input.empty(); ++tricks_) {
      Planned& planned = trick_[tricks_];
      planned.trick = static_cast<Trick>(input.byte() % kTricks);
      planned.number = input.byte();
      if (planned.trick == Trick::invent || planned.trick == Trick::flood) planned.frame = input.frame(likely, true);
    }
  }
  void behave(std::uint64_t number) {
    exchange_ = number;
    tricks_ = next_trick_ = 0;
    kept_ = 0;
  }

  void on_frame(const hal::Frame& frame, std::int64_t now_ns, hal::FrameQueue& answers) LITHE_RT override {
    for (std::size_t i = 0; i < devices_; ++i) device_[i]->on_frame(frame, now_ns, said_);
    pass_on(answers);
  }
  // The bus has just thrown away what nobody took.
  void on_time(std::int64_t now_ns, hal::FrameQueue& answers) LITHE_RT override {
    under_way_to_ = under_way_from_;
    for (std::size_t i = 0; i < kept_; ++i) say(kept_back_[i], answers);
    kept_ = 0;
    for (std::size_t i = 0; i < devices_; ++i) device_[i]->on_time(now_ns, said_);
    pass_on(answers);
  }

  // Frames that went onto the bus.
  std::uint64_t pushed() const { return pushed_; }
  // When the frame that was received next was said.
  std::uint64_t received() LITHE_RT { return under_way_[under_way_from_++ % under_way_.size()]; }

 private:
  struct Planned {
    Trick trick = Trick::honest;
    std::uint8_t number = 0;
    hal::Frame frame;
  };

  void pass_on(hal::FrameQueue& answers) LITHE_RT {
    for (; const hal::Frame* frame = said_.front(); said_.pop()) {
      const Said said{*frame, exchange_};
      history_[heard_++ % kHistory] = said;
      next_trick_ < tricks_ ? play(trick_[next_trick_++], said, answers) : say(said, answers);
    }
  }

  void play(const Planned& planned, Said said, hal::FrameQueue& answers) LITHE_RT {
    switch (planned.trick) {
      case Trick::drop:
        return;
      case Trick::twice:
        say(said, answers);
        break;
      case Trick::later:
        if (kept_ < kept_back_.size()) kept_back_[kept_++] = said;
        return;
      case Trick::spoil:
        said.frame.data[planned.number % 64U] =
            static_cast<std::uint8_t>(said.frame.data[planned.number % 64U] ^ planned.number);
        said.exchange = 0;
        break;
      case Trick::readdress:
        said.frame.id ^= 1U << planned.number % 11U;
        said.exchange = 0;
        break;
      case Trick::old:
        if (planned.number < heard_) say(history_[(heard_ - 1 - planned.number) % kHistory], answers);
        break;
      case Trick::cut:
        said.frame.size = static_cast<std::uint8_t>(planned.number % (said.frame.size + 1U));
        said.exchange = 0;
        break;
      case Trick::invent:
        say({planned.frame, 0}, answers);
        break;
      case Trick::flood:
        for (unsigned i = 0; i < planned.number; ++i) say({planned.frame, 0}, answers);
        break;
      case Trick::honest:
        break;
    }
    say(said, answers);
  }

  void say(const Said& said, hal::FrameQueue& answers) LITHE_RT {
    if (!answers.push(said.frame)) return;
    ++pushed_;
    under_way_[under_way_to_++ % under_way_.size()] = said.exchange;
  }

  std::array<hal::BusNode*, 8> device_{};
  std::size_t devices_ = 0;
  hal::FrameQueue said_;
  std::array<Planned, kMostTricks> trick_{};
  std::size_t tricks_ = 0;
  std::size_t next_trick_ = 0;
  std::uint64_t exchange_ = 0;
  std::array<Said, kHistory> history_{};
  std::uint64_t heard_ = 0;
  std::array<Said, 64> kept_back_{};
  std::size_t kept_ = 0;
  std::array<std::uint64_t, hal::FrameQueue::kCapacity> under_way_{};
  std::size_t under_way_from_ = 0;
  std::size_t under_way_to_ = 0;
  std::uint64_t pushed_ = 0;
};

// What drivers made of the frames of one bus, as told beside the product's own counters.
struct Ledger {
  std::uint64_t age = 0;      // of the frame that is being looked at, in exchanges; 0: of now, or nobody said it
  std::uint64_t gateway = 0;  // frames of the robot's gateway
  std::uint64_t parts = 0, late = 0, malformed = 0;
  std::uint64_t answers = 0;  // of them were
  std::uint64_t used = 0, repeated = 0, unmeasured = 0;
  bool old_was_used = false;

  std::uint64_t taken() const { return parts + late + malformed + answers; }
};

// A bus that tells the ledger what passes.
class WatchedBus final : public hal::Bus {
 public:
  WatchedBus(Peer& peer, Ledger& ledger, std::uint32_t gateway) : peer_(peer), ledger_(ledger), gateway_(gateway, 1) {
    loop_.attach(peer);
  }

  const hal::gateway::Counters& gateway() const { return gateway_.counters(); }

  void begin(std::int64_t now_ns) LITHE_RT override {
    ++exchange_;
    loop_.begin(now_ns);
    statistics_ = loop_.statistics();
  }
  bool send(const hal::Frame& frame) LITHE_RT override {
    const bool sent = loop_.send(frame);
    statistics_ = loop_.statistics();
    return sent;
  }
  bool receive(hal::Frame& frame) LITHE_RT override {
    const bool received = loop_.receive(frame);
    statistics_ = loop_.statistics();
    if (!received) return false;
    const std::uint64_t said = peer_.received();
    ledger_.age = said == 0 ? 0 : exchange_ - said;
    if (!hal::gateway::is_gateway(frame) || hal::gateway::node_of(frame) != gateway_.node()) return true;
    ++ledger_.gateway;
    gateway_.on_frame(frame, 0);
    return true;
  }

 private:
  hal::LoopBus loop_;
  Peer& peer_;
  Ledger& ledger_;
  hal::gateway::Gateway gateway_;  // hears what the robot's own hears
  std::uint64_t exchange_ = 0;
};

// A driver that tells the ledger what it made of a frame. `knows_age`: an old answer is known as such.
class WatchedDrive final : public hal::Drive {
 public:
  WatchedDrive(std::unique_ptr<hal::Drive> drive, Ledger& ledger, bool knows_age)
      : drive_(std::move(drive)), ledger_(ledger), knows_age_(knows_age) {}

  bool command(const hal::JointCommand& command, const hal::Exchange& exchange, hal::Bus& bus) LITHE_RT override {
    asked_ = exchange.number;
    return drive_->command(command, exchange, bus);
  }
  hal::ReplyKind on_frame(const hal::Frame& frame, const hal::Exchange& exchange, hal::JointSample& sample)
      LITHE_RT override {
    const hal::ReplyKind heard = drive_->on_frame(frame, exchange, sample);
    ledger_.parts += heard == hal::ReplyKind::part ? 1 : 0;
    ledger_.late += heard == hal::ReplyKind::late ? 1 : 0;
    ledger_.malformed += heard == hal::ReplyKind::malformed ? 1 : 0;
    if (heard == hal::ReplyKind::answer) note(exchange.number, sample.measured);
    return heard;
  }

 private:
  // The first one that measures something counts, where one was asked for.
  void note(std::uint64_t exchange, bool measured) LITHE_RT {
    if (exchange != asked_) {
      ++ledger_.late;
      return;
    }
    ++ledger_.answers;
    ledger_.old_was_used |= knows_age_ && ledger_.age > 0;
    if (exchange == answered_) {
      ++ledger_.repeated;
    } else if (!measured) {
      ++ledger_.unmeasured;
    } else {
      ++ledger_.used;
      answered_ = exchange;
    }
  }

  std::unique_ptr<hal::Drive> drive_;
  Ledger& ledger_;
  std::uint64_t asked_ = 0;     // exchange
  std::uint64_t answered_ = 0;  // exchange
  bool knows_age_;
};

}  // namespace lithe::fuzz
