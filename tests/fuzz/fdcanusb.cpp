// SPDX-License-Identifier: Apache-2.0
// fdcanusb: the codec of both sides, the bus over a terminal, the simulated adapter.
#include "spine/hal/bus/fdcanusb/fdcanusb_bus.hpp"
#include "spine/hal/bus/fdcanusb/fdcanusb_codec.hpp"
#include "spine/hal/bus/fdcanusb/sim_fdcanusb.hpp"
#include "spine/hal/bus/serial/words.hpp"
#include "tests/fuzz/text_path.hpp"

namespace lithe::fuzz {
namespace {

using namespace hal;
using fdcanusb::Line;
using fdcanusb::Request;
using fdcanusb::Sum;

enum Way : std::uint8_t { kTerminal = 1, kAdapter = 2, kSumsOn = 4 };

// The checksum by its definition, bit by bit.
std::uint8_t sum_of(std::string_view text) {
  unsigned sum = 0;
  for (const char c : text) {
    sum ^= static_cast<std::uint8_t>(c);
    for (int bit = 0; bit < 8; ++bit) sum = (sum << 1 ^ ((sum & 0x80) != 0 ? 0x97U : 0U)) & 0xff;
  }
  return static_cast<std::uint8_t>(sum);
}

Sum sum_in(std::string_view line) {
  std::uint32_t said = 0;
  if (line.size() < 3 || line[line.size() - 3] != '*' || !hex_number(line.substr(line.size() - 2), said))
    return Sum::absent;
  return said == sum_of(line.substr(0, line.size() - 3)) ? Sum::right : Sum::wrong;
}

// A frame survives being said in each of the ways there are.
void there_and_back(const Frame& frame) {
  require(is_can(frame), "a parsed frame is one that CAN has");
  std::array<char, fdcanusb::kLongestLine> text{};
  Line line;
  for (const bool sums : {false, true}) {
    std::size_t size = fdcanusb::format_received(frame, text);
    if (sums) size = fdcanusb::append_sum(text, size);
    const bool parsed = fdcanusb::parse_line({text.data(), size}, sums, line);
    require(size > 0 && parsed && line.kind == Line::Kind::received && same(line.frame, frame),
            "a received frame is read as it was said");
    size = fdcanusb::format_send(frame, sums, text);
    if (frame.size == 0) continue;  // cannot be said
    std::string_view command(text.data(), size - 1);
    require(size > 0 && text[size - 1] == '\n', "a command ends its line");
    require(fdcanusb::strip_sum(command) == (sums ? Sum::right : Sum::absent), "a command has the sum it was to have");
    Request request;
    const char* wrong = fdcanusb::parse_request(command, {!frame.fd, !frame.brs}, request);
    require(wrong == nullptr && request.kind == Request::Kind::send && same(request.frame, frame),
            "a command is read as it was said, whatever the adapter's defaults");
  }
}

void one_line(std::string_view text) {
  const Sum sum = sum_in(text);
  for (const bool wanted : {false, true}) {
    Line line;
    if (!fdcanusb::parse_line(text, wanted, line)) continue;
    require(sum != Sum::wrong, "no line with a wrong sum is believed");
    require(!wanted || sum == Sum::right, "no line without the sum that is wanted is believed");
    require(text.size() <= fdcanusb::kLongestLine, "no line is longer than the longest");
    if (line.kind == Line::Kind::received) there_and_back(line.frame);
  }
  Request request;
  if (fdcanusb::parse_request(text, {}, request) == nullptr && request.kind == Request::Kind::send)
    there_and_back(request.frame);
}

Told expected_of(std::string_view text, bool sums) {
  Told told;
  bool bus_off = false;
  each_line(text, "\r\n", [&](std::string_view line) {
    if (line.size() > kLongestBusLine) {
      ++told.malformed;
      return;
    }
    line.remove_suffix(1);
    if (line.empty()) return;
    Line said;
    if (!fdcanusb::parse_line(line, sums, said)) {
      ++told.malformed;
      return;
    }
    sums |= sum_in(line) == Sum::right;
    if (said.kind == Line::Kind::received) told.frames.push_back(said.frame);
    told.acknowledged += said.kind == Line::Kind::ok ? 1 : 0;
    const bool beside = said.kind == Line::Kind::error && said.text == "already in BusOn";
    told.ignored += beside || said.kind == Line::Kind::other ? 1 : 0;
    told.errors += said.kind == Line::Kind::error && !beside ? 1 : 0;
    if (said.kind == Line::Kind::other && said.text.starts_with("lec=")) {
      const bool off = said.text.find("busoff=1") != std::string_view::npos;
      told.noticed += off && !bus_off ? 1 : 0;
      bus_off = off;
    }
    sums |= said.kind == Line::Kind::error && said.text.find("checksum") != std::string_view::npos;
  });
  return told;
}

void terminal(std::string_view text, bool sums, Input& cuts) {
  pty().heard();
  auto bus = FdcanusbBus::open({pty().device(), sums ? Checksums::on : Checksums::automatic, 0});
  require(bool(bus), "a terminal opens");
  const std::string whole = std::string(text.substr(0, kMostText)) + "\n";
  through_terminal(**bus, whole, cuts, expected_of(whole, sums));
}

void adapter(std::string_view text, Input& cuts) {
  sim::SimFdcanusb adapter;
  each_line(adapter_says(adapter, text, cuts), "\n", [](std::string_view line) {
    require(line.ends_with("\r\n"), "an adapter ends its lines");
    Line said;
    require(fdcanusb::parse_line(line.substr(0, line.size() - 2), false, said), "a host understands the adapter");
  });
}

}  // namespace

void run(Bytes bytes) {
  Input input(bytes);
  const std::uint8_t way = input.byte();
  Input cuts(input.bytes(8));
  const std::string_view text = input.text(1 << 14);
  each_line(text, "\r\n", [](std::string_view line) { one_line(line.substr(0, line.size() - 1)); });
  if ((way & kTerminal) != 0) terminal(text, (way & kSumsOn) != 0, cuts);
  if ((way & kAdapter) != 0) adapter(text, cuts);
}

std::vector<Seed> seeds() {
  const std::string_view cuts("\0\1\2\5\3\0\1\7", 8);
  std::vector<Seed> all;
  const auto add = [&](unsigned way, std::string_view text) {
    all.push_back(Script().byte(way).text(cuts).text(text));
  };
  const std::string heard =
      "OK\r\nrcv 0100 21000A2F0100000000 E B F r x-1\r\nrcv 105 0102 e b f\r\nrcv 7FF AA B F\r\nERR unknown command\r\n"
      "rcv 1 00112233445566778899AABB e B F\r\nrcv 100  E B F\r\nrcv 2 1122 R\r\nconf 1\r\n\n\r"
      "rcv 20000000 00 E\nrcv 100 001\nrcv 7 00112233445566778899 f\nrcv 7 0011 e B f\n";
  const std::string commands =
      "can send 8001 01000011001F01130D bf\ncan std 105 0102 BF\ncan ext 7 00 b\ncan send 1 001122334455667788 F\n"
      "can status\nlec=5 err=1 busoff=1\nlec=0 busoff=0\nERR already in BusOn\ncan off\ncan send 1 00\ncan on\ncan "
      "config\nconf get can.bitrate\nconf set can.fdcan_frame 0\n"
      "conf enumerate\nconf write\nconf load\nconf default\ncan send 9 0102030405060708090A\ncan send 1 00 R\nhello\n";
  std::string summed;
  for (const std::string_view line : {"rcv 0100 2100 E B F", "OK", "ERR checksum", "rcv 1 00", "can status"}) {
    std::array<char, 256> text{};
    line.copy(text.data(), text.size());
    summed.append(text.data(), fdcanusb::append_sum(text, line.size())) += "\r\n";
  }
  for (const std::string& text : {heard, commands, summed, summed + heard, std::string(300, 'x') + "\nOK\n"})
    for (const unsigned way : List<unsigned>{0, kTerminal, kTerminal | kSumsOn, kAdapter}) add(way, text);
  add(kAdapter, "can send 1 00 *00\n" + summed + commands);
  add(kTerminal, "OK *00\r\n" + heard);
  return all;
}

}  // namespace lithe::fuzz
