// SPDX-License-Identifier: Apache-2.0
// The moteus terminal against drives that say anything, for as long as they like: it comes back, with an answer or an
// error, in the time that its contract allows.
#include "spine/hal/moteus/moteus_terminal.hpp"

#include <algorithm>
#include <string>

#include "tests/fuzz/fuzz.hpp"

namespace lithe::fuzz {
namespace {

using namespace hal;
using namespace hal::moteus;

constexpr std::uint32_t kId = 3;
constexpr std::array<std::uint32_t, 4> kLikely{kId << 8, 4 << 8, kId << 8 | 1, 0};
constexpr std::size_t kMostFrames = 48;
// Of a clock that goes on by 10 ms with each look at it. No command takes longer than this, whatever it hears.
constexpr std::int64_t kMostLooks = 40'000;

enum Way : std::uint8_t { kForEver = 1, kOnlyWhenAsked = 2, kToWhoeverAsks = 4 };

// Frames in a row, and from the start again if they are said for ever. Says one for each that is sent, or babbles.
class Mouth final : public Bus {
 public:
  Mouth(std::vector<Frame> frames, std::uint8_t way) : frames_(std::move(frames)), way_(way) {}

  void begin(std::int64_t /*now_ns*/) LITHE_RT override { due_ = 0; }
  bool send(const Frame& frame) LITHE_RT override {
    sane_ = sane_ && is_can(frame);
    source_ = frame.id >> 8 & 0x7f;
    ++due_;
    return true;
  }
  bool receive(Frame& frame) LITHE_RT override {
    if ((way_ & kForEver) != 0 && next_ == frames_.size()) next_ = 0;
    if (next_ == frames_.size() || ((way_ & kOnlyWhenAsked) != 0 && due_ == 0)) return false;
    --due_;
    frame = frames_[next_++];
    if ((way_ & kToWhoeverAsks) != 0) frame.id = (frame.id & ~0xffU) | source_;
    return true;
  }
  bool sane() const { return sane_; }

 private:
  std::vector<Frame> frames_;
  std::uint8_t way_;
  std::size_t next_ = 0;
  std::uint32_t source_ = 0;
  int due_ = 0;
  bool sane_ = true;
};

std::vector<Frame> frames_of(Input& input) {
  std::vector<Frame> frames;
  while (frames.size() < kMostFrames && !input.empty()) frames.push_back(input.frame(kLikely, true));
  return frames;
}

}  // namespace

void run(Bytes bytes) {
  Input input(bytes);
  const std::uint8_t way = input.byte(), verb = input.byte() % 2;
  const std::string words(input.text(input.byte() % 100));
  Mouth mouth(frames_of(input), way);
  std::int64_t looks = 0;
  const Time time{[&] {
                    require(++looks < kMostLooks, "a terminal comes back");
                    return looks * 10'000'000;
                  },
                  [] {}};
  Terminal terminal(mouth, time);
  if (verb == 0) {
    std::uint32_t last = 0;
    for (const Found& found : terminal.discover()) {
      require(found.id >= std::max(last, 1U) && found.id <= 126, "drives are told in order of their addresses");
      last = found.id;
    }
  } else {
    Found who{kId, {}, (way & kForEver) != 0};
    std::copy_n(words.begin(), std::min(words.size(), who.uuid.size()), who.uuid.begin());
    const Result<Identity> identity = terminal.identify(who);
    require(identity || !identity.message().empty(), "an error has words");
  }
  require(mouth.sane(), "what is sent is a frame that CAN has");
}

std::vector<Seed> seeds() {
  const auto says = [](std::string_view text) {
    Frame frame;
    frame.id = kId << 8;
    frame.fd = frame.brs = true;
    SubframeWriter writer(frame);
    writer.server_data(1, {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()});
    writer.pad();
    return frame;
  };
  Frame found;
  found.id = kId << 8;
  SubframeWriter writer(found);
  writer.reply(Format::int32, reg::kUuid, std::array{1.0, 2.0, 3.0, 4.0}, true);
  writer.error(Kind::read_error, reg::kUuidMaskCapable, 1);
  writer.pad();
  Frame identity;
  identity.id = kId << 8;
  SubframeWriter is(identity);
  is.reply(Format::int32, reg::kModel, std::array{1.0, 65536.0, 5.0}, false);
  is.reply(Format::int32, reg::kSerial, std::array{1.0, 2.0, 3.0}, true);
  is.pad();
  std::vector<Seed> all;
  for (unsigned way = 0; way < 8; ++way)
    for (unsigned verb = 0; verb < 2; ++verb)
      all.push_back(Script().byte(way).byte(verb).byte(3).text("tel").frame(found).frame(identity).frame(says("a\n")));
  return all;
}

}  // namespace lithe::fuzz
