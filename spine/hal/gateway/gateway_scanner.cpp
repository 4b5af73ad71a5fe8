// SPDX-License-Identifier: Apache-2.0
// Sensor gateways for `lithe bus scan` and `lithe bus monitor`.
#include <fmt/format.h>

#include <array>
#include <map>

#include "spine/hal/gateway/gateway.hpp"

namespace lithe::hal::gateway {
namespace {

constexpr std::array kBlockNames{"analog", "digital", "imu"};
static_assert(kBlockNames.size() == kBlocks);

class GatewayScanner final : public Scanner {
 public:
  std::string on_frame(const Frame& frame) override {
    Observed& one = observed_[node_of(frame)];
    ++one.frames;
    const std::uint32_t block = frame.id & 0xff;
    if (block < kBlocks) one.blocks |= 1U << block;
    return "";
  }

  std::vector<FoundDevice> found(bool /*asked*/) const override {
    std::vector<FoundDevice> all;
    for (const auto& [id, one] : observed_) {
      std::string blocks;
      for (std::size_t i = 0; i < kBlocks; ++i)
        if ((one.blocks >> i & 1) != 0) blocks += fmt::format("{}{}", blocks.empty() ? "" : ", ", kBlockNames[i]);
      all.push_back(
          {.id = id,
           .what = fmt::format("{} frames heard: {}", one.frames, blocks.empty() ? "no known channels" : blocks)});
    }
    return all;
  }

 private:
  struct Observed {
    std::uint64_t frames = 0;
    std::uint32_t blocks = 0;  // bit of Block
  };
  std::map<std::uint32_t, Observed> observed_;
};

}  // namespace

std::unique_ptr<Scanner> make_scanner() { return std::make_unique<GatewayScanner>(); }

FrameText frame_text(const Frame& frame, const FrameContext& /*context*/) {
  FrameText decoded{false, node_of(frame), ""};
  const std::uint32_t block = frame.id & 0xff;
  const auto bytes = frame.payload();
  if (block >= kBlocks || bytes.size() < kHeader + 2) {
    decoded.text = "gateway, malformed: " + bytes_text(frame);
    return decoded;
  }
  const auto word_at = [&](std::size_t at) { return static_cast<std::uint16_t>(bytes[at] | bytes[at + 1] << 8); };
  decoded.text = fmt::format("{} #{} at {:.1f} ms:", kBlockNames[block], bytes[0], 0.1 * word_at(2));
  if (block == static_cast<std::uint32_t>(Block::digital)) {
    const std::uint16_t valid = bytes.size() >= kHeader + 4 ? word_at(kHeader + 2) : 0;
    decoded.text += fmt::format(" {:016b}, valid {:016b}", word_at(kHeader), valid);
    return decoded;
  }
  for (std::size_t at = kHeader; at + 1 < bytes.size(); at += 2) {
    const std::size_t channel = bytes[1] + (at - kHeader) / 2;
    if (channel >= kChannels) break;
    const auto raw = static_cast<std::int16_t>(word_at(at));
    decoded.text += raw == kInvalid ? fmt::format(" {}=-", channel) : fmt::format(" {}={}", channel, raw);
  }
  return decoded;
}

}  // namespace lithe::hal::gateway
