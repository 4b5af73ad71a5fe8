// SPDX-License-Identifier: Apache-2.0
// The sensor gateway's decoder against a slow and plain reading of the same frames.
#include "spine/hal/gateway/gateway.hpp"

#include <map>
#include <utility>

#include "spine/hal/gateway/sim/sim_gateway.hpp"
#include "tests/fuzz/fuzz.hpp"

namespace lithe::fuzz {
namespace {

using namespace hal;
using gateway::Block;
using gateway::Gateway;

constexpr std::uint32_t kNode = 20;
constexpr std::int64_t kStaleNs = 50'000'000;
constexpr std::array<std::uint32_t, 5> kLikely{gateway::kIdBase | kNode << 8, gateway::kIdBase | kNode << 8 | 1,
                                               gateway::kIdBase | kNode << 8 | 2, gateway::kIdBase | kNode << 8 | 3,
                                               gateway::kIdBase | 21 << 8};

// What the header of gateway.hpp says, channel by channel.
class Plain {
 public:
  void on_frame(const Frame& frame, std::int64_t now_ns) {
    ++frames;
    began_ = false;
    const Bytes data = frame.payload();
    const std::uint32_t block = frame.id & 0xff;
    const bool digital = block == 1;
    if (block > 2 || data.size() < (digital ? 8U : 6U) || data.size() % 2 != 0 || data[1] > (digital ? 0 : 15)) return;
    if (now_ns - last_ns_ > kStaleNs) heard_ = false;  // after a silence nothing is known
    const auto ahead = static_cast<std::uint8_t>(data[0] - sequence_);
    if (heard_ && (ahead == 0 || ahead > 128)) return;
    began_ = !heard_;
    heard_ = true;
    sequence_ = data[0];
    last_ns_ = now_ns;
    for (std::size_t channel = 0; channel < 16; ++channel) {
      if (digital) {
        const unsigned values = data[4] | data[5] << 8, valid = data[6] | data[7] << 8;
        keep(block, channel, values >> channel & 1, (valid >> channel & 1) != 0, now_ns);
      } else if (channel >= data[1] && 4 + 2 * (channel - data[1]) < data.size()) {
        const std::size_t at = 4 + 2 * (channel - data[1]);
        const auto raw = static_cast<std::int16_t>(data[at] | data[at + 1] << 8);
        keep(block, channel, raw, raw != -32768, now_ns);
      }
    }
  }
  // Null: nothing to be read.
  const double* read(std::uint32_t block, std::size_t channel, std::int64_t now_ns) const {
    const auto found = channels_.find({block, channel});
    if (found == channels_.end() || !found->second.valid || now_ns - found->second.from_ns > kStaleNs) return nullptr;
    return &found->second.raw;
  }
  // The last frame was the first one, or the first after a silence: its values are of now, whatever it says.
  bool began() const { return began_; }
  std::uint64_t frames = 0;

 private:
  struct Channel {
    double raw;
    bool valid;
    std::int64_t from_ns;
  };
  void keep(std::uint32_t block, std::size_t channel, double raw, bool valid, std::int64_t now_ns) {
    channels_[{block, channel}] = {raw, valid, now_ns};
  }
  std::map<std::pair<std::uint32_t, std::size_t>, Channel> channels_;
  bool heard_ = false;
  bool began_ = false;
  std::uint8_t sequence_ = 0;
  std::int64_t last_ns_ = 0;
};

void compare(const Gateway& gateway, const Plain& plain, std::int64_t now_ns) {
  for (std::uint32_t block = 0; block < gateway::kBlocks; ++block) {
    for (std::size_t channel = 0; channel <= gateway::kChannels; ++channel) {
      double raw = 0.5;
      const bool valid = gateway.read(static_cast<Block>(block), channel, now_ns, raw);
      const double* expected = plain.read(block, channel, now_ns);
      // By its stamp a value may be older than its frame, never newer.
      require(!valid || expected != nullptr, "a channel is valid only when the frames say so");
      require(valid || expected == nullptr || !plain.began(), "a channel is valid when the frames say so");
      require(raw == (valid ? *expected : 0.5), "a channel reads as the frames say");
      require(!valid || (raw >= -32767 && raw <= 32767), "a channel is a number of its range");
    }
  }
  const gateway::Counters& count = gateway.counters();
  require(count.frames + count.repeated + count.malformed == plain.frames, "every frame is counted once");
}

}  // namespace

void run(Bytes bytes) {
  Input input(bytes);
  Gateway gateway(kNode, kStaleNs);
  Plain plain;
  std::int64_t now_ns = 1'000'000'000;
  for (int i = 0; i < 64 && !input.empty(); ++i) {
    now_ns += input.byte() * 1'000'000;
    const Frame frame = input.frame(kLikely, true);
    gateway.on_frame(frame, now_ns);
    plain.on_frame(frame, now_ns);
    compare(gateway, plain, now_ns);
  }
}

std::vector<Seed> seeds() {
  std::vector<Seed> all;
  for (const bool fd : {false, true}) {
    sim::SimGateway device(kNode, 1'000'000, fd);
    device.unplug_input(Block::analog, 3);
    FrameQueue said;
    Script script, replayed, gaps;
    for (int i = 0; i < 40; ++i) {
      device.on_time(1'000'000 * (i + 1), said);
      const Frame frame = *said.front();
      said.clear();
      script.byte(i == 30 ? 60 : 1).frame(frame);
      replayed.byte(2).frame(frame).byte(0).frame(frame);
      if (i % 3 != 1) gaps.byte(1).frame(frame);
      Frame cut = frame;
      cut.size = static_cast<std::uint8_t>(i % 9);
      gaps.byte(1).frame(cut);
    }
    all.insert(all.end(), {script, replayed, gaps});
  }
  return all;
}

}  // namespace lithe::fuzz
