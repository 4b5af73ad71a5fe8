// SPDX-License-Identifier: Apache-2.0
// slcan: the codec of both sides, the bus over a terminal, the simulated adapter.
#include "spine/hal/bus/slcan/sim_slcan.hpp"
#include "spine/hal/bus/slcan/slcan_bus.hpp"
#include "spine/hal/bus/slcan/slcan_codec.hpp"
#include "tests/fuzz/text_path.hpp"

namespace lithe::fuzz {
namespace {

using namespace hal;
using slcan::Answer;

enum Way : std::uint8_t { kTerminal = 1, kAdapter = 2, kSilent = 4 };
constexpr std::string_view kEnds = "\r\a";

void there_and_back(const Frame& frame) {
  require(is_can(frame), "a parsed frame is one that CAN has");
  std::array<char, slcan::kLongestLine> text{};
  const std::string_view line(text.data(), slcan::format_frame(frame, text));
  require(!line.empty() && line.size() <= slcan::kLongestLine, "every frame can be said");
  Frame again;
  require(slcan::parse_answer(line, again) == Answer::frame && same(again, frame), "a host reads what was said");
  require(slcan::parse_request(line.substr(0, line.size() - 1), again) == slcan::Request::send && same(again, frame),
          "an adapter reads what was said");
  for (std::size_t room = 0; room < line.size(); ++room)
    require(slcan::format_frame(frame, std::span(text).first(room)) == 0, "what does not fit is not said");
}

void one_line(std::string_view line) {
  Frame untouched;
  untouched.id = 0x123;
  Frame frame = untouched;
  if (slcan::parse_answer(line, frame) == Answer::frame)
    there_and_back(frame);
  else
    require(same(frame, untouched), "only a frame changes the frame");
  frame = untouched;
  if (slcan::parse_request(line.substr(0, line.size() - 1), frame) == slcan::Request::send)
    there_and_back(frame);
  else
    require(same(frame, untouched), "only a frame changes the frame");
}

Told expected_of(std::string_view text) {
  Told told;
  each_line(text, kEnds, [&](std::string_view line) {
    if (told.bus_off) return;
    Frame frame;
    const Answer answer = line.size() > kLongestBusLine ? Answer::malformed : slcan::parse_answer(line, frame);
    if (answer == Answer::frame) told.frames.push_back(frame);
    told.acknowledged += answer == Answer::done || answer == Answer::sent ? 1 : 0;
    told.bus_off = answer == Answer::bus_off;
    told.errors += answer == Answer::refused || answer == Answer::error || told.bus_off ? 1 : 0;
    told.malformed += answer == Answer::malformed ? 1 : 0;
    told.ignored += answer == Answer::other ? 1 : 0;
  });
  return told;
}

void terminal(std::string_view text, Input& cuts) {
  pty().heard();
  auto bus = SlcanBus::open({pty().device(), 1'000'000, 5'000'000, 0});
  require(bool(bus), "a terminal opens");
  const std::string whole = std::string(text.substr(0, kMostText)) + "\r";
  const Told expected = expected_of(whole);
  through_terminal(**bus, whole, cuts, expected);
  bus->reset();
  if (expected.bus_off) pty(true);
}

void adapter(std::string_view text, bool silent, Input& cuts) {
  sim::SimSlcan adapter(silent ? sim::SlcanManners::silent : sim::SlcanManners::lawicel);
  each_line(adapter_says(adapter, text, cuts), kEnds, [&](std::string_view line) {
    Frame frame;
    const Answer answer = slcan::parse_answer(line, frame);
    require(answer != Answer::malformed, "a host understands the adapter");
    require(!silent || answer == Answer::frame || answer == Answer::other, "a silent adapter says what it must only");
  });
}

}  // namespace

void run(Bytes bytes) {
  Input input(bytes);
  const std::uint8_t way = input.byte();
  Input cuts(input.bytes(8));
  const std::string_view text = input.text(1 << 14);
  each_line(text, kEnds, one_line);
  if ((way & kTerminal) != 0) terminal(text, cuts);
  if ((way & kAdapter) != 0) adapter(text, (way & kSilent) != 0, cuts);
}

std::vector<Seed> seeds() {
  const std::string_view cuts("\0\1\2\5\3\0\1\7", 8);
  std::vector<Seed> all;
  const std::string heard = "t1232AABB\rT000001232AABB\rd7FF9000102030405060708090A0B\rB1FFFFFFFF" +
                            std::string(128, '5') +
                            "\rb0011AA1234\rr1234\rR000001234\rz\rZ\r\r\as01\rSA\re0100\rV1013\rNLTHE\rF00\rt8000\rt123"
                            "90102030405060708\rq\r";
  const std::string commands =
      "C\rS8\rY5\rZ1\rO\rt1232AABB\rd7FF9000102030405060708090A0B\rT1FFFFFFF81122334455667788\rr1231\rV\rN\rF\rS6\rC\r"
      "Z0\rS9\rs0123\rX1\rQ0\rm1\rM00000000\rL\rt1230\rO\rC\rO\rB0000000112\rt1230\r\r";
  for (const std::string& text :
       {heard, commands, commands + heard, heard + "sb255000\r" + heard, std::string(300, '0') + "\rt1230\r"}) {
    for (const unsigned way : List<unsigned>{0, kTerminal, kAdapter, kAdapter | kSilent})
      all.push_back(Script().byte(way).text(cuts).text(text));
  }
  return all;
}

}  // namespace lithe::fuzz
