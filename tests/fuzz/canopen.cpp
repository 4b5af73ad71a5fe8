// SPDX-License-Identifier: Apache-2.0
// CANopen: any frames into the SDO client, emergencies, heartbeats and process data; and the client against a simulated
// drive over a wire that is whole, where every object must come out as the dictionary has it.
#include "spine/hal/canopen/canopen.hpp"

#include <limits>

#include "spine/hal/canopen/canopen_pdo.hpp"
#include "spine/hal/cia402/sim/sim_cia402.hpp"
#include "tests/fuzz/fuzz.hpp"

namespace lithe::fuzz {
namespace {

using namespace hal;
using namespace hal::canopen;
using Outcome = SdoClient::Outcome;

constexpr std::uint32_t kNode = 5;
constexpr std::array<std::uint32_t, 7> kLikely{0x585, 0x605, 0x705, 0x085, 0x185, 0x586, 0x285};
constexpr int kMostSteps = 128;

// Whatever was heard: with nobody there it gives up in bounded time, and says so.
void comes_to_an_end(SdoClient& client, std::int64_t now_ns) {
  Frame frame;
  for (int i = 0; i < 32 && client.outcome() == Outcome::busy; ++i)
    client.next(now_ns += SdoClient::kTimeoutsNs.back(), frame);
  require(client.outcome() != Outcome::busy, "a transfer that nobody answers ends");
}

void check_sent(const Frame& frame) {
  require(is_canopen(frame) && frame.size == 8 && frame.id == cob::kSdoRequest + kNode,
          "a request is one, to the node");
}

void client_hears(Input& input) {
  SdoClient client(kNode);
  std::int64_t now_ns = 0;
  Frame frame;
  for (int i = 0; i < kMostSteps && !input.empty(); ++i) {
    const std::uint8_t what = input.byte();
    const Address address{input.number<std::uint16_t>(), input.byte()};
    if (what % 8 == 0) client.read(address);
    if (what % 8 == 1) client.write(address, input.number<std::uint32_t>(), 1 + what / 8 % 4);
    if (what % 8 == 2) now_ns += SdoClient::kTimeoutsNs.back();
    if (what % 8 == 3) client.forget();
    if (client.next(now_ns, frame)) check_sent(frame);
    if (what % 8 < 4) continue;
    const Outcome before = client.outcome();
    const std::uint64_t strays = client.strays();
    Frame heard = input.frame(kLikely);
    if (what % 8 > 5 && heard.size == 8) {  // of the object that is asked for
      put_little_endian(heard.data.data() + 1, client.address().index, 2);
      heard.data[3] = client.address().subindex;
    }
    const bool taken = client.on_frame(heard);
    require(taken == (client.strays() == strays), "what answers nothing is counted");
    require(taken || client.outcome() == before, "what answers nothing changes nothing");
    require(!taken || before == Outcome::busy, "nothing is taken that was not asked for");
    require(!taken || (heard.id == cob::kSdoAnswer + kNode && is_canopen(heard) && heard.size == 8),
            "it was an answer");
    const bool segment = heard.data[0] >> 5 == 0;
    require(!taken || segment || heard.data[0] == 0x80 || sdo_address(heard) == client.address(),
            "it is of that object");
    require(client.data().size() <= SdoClient::kLongest, "an upload has an end");
    require(client.value() <= std::numeric_limits<std::uint32_t>::max(), "a value can be read");
  }
  comes_to_an_end(client, now_ns);
}

void other_frames(Input& input) {
  HeartbeatConsumer consumer;
  std::int64_t now_ns = 0;
  for (int i = 0; i < kMostSteps && !input.empty(); ++i) {
    const Frame frame = input.frame(kLikely, true);
    NmtState state{0x33};
    const bool beat = parse_heartbeat(frame, state);
    require(beat || state == NmtState{0x33}, "only a heartbeat changes the state");
    require(!beat || same(heartbeat_frame(node_of(frame), state),
                          [&] {
                            Frame plain = frame;
                            plain.data[0] &= 0x7f;
                            return plain;
                          }()),
            "a heartbeat is read as it is said");
    Emergency what{0x1234, 0x56};
    const bool emergency = parse_emergency(frame, what);
    require(emergency || (what.code == 0x1234 && what.error_register == 0x56), "only an emergency changes it");
    require(!emergency || (node_of(frame) >= 1 && frame.size == 8), "an emergency is somebody's");
    now_ns += input.byte() * 1'000'000;
    consumer.set_timeout(input.byte() * 1'000'000);
    if (beat) consumer.received(now_ns);
    require(!consumer.lost(now_ns) || !beat || consumer.deadline_ns() > now_ns, "what beats is not lost");
  }
}

void process_data(Input& input) {
  PdoMap map;
  std::array<std::uint32_t, PdoMap::kMost> values{};
  for (std::uint8_t i = 0; i < 12; ++i) {
    const std::uint8_t bytes = std::array<std::uint8_t, 3>{1, 2, 4}[input.byte() % 3];
    const std::size_t before = map.bytes();
    const bool added = map.add({{input.number<std::uint16_t>(), i}, bytes});
    require(map.bytes() == before + (added ? bytes : 0) && map.bytes() <= 8 && map.objects().size() <= PdoMap::kMost,
            "a map holds what fits");
  }
  for (std::uint32_t& value : values) value = input.number<std::uint32_t>();
  const Frame packed = map.pack(0x185, values);
  std::array<std::uint32_t, PdoMap::kMost> again{};
  require(is_canopen(packed) && map.unpack(packed, again), "what is packed is unpacked");
  for (std::size_t i = 0; i < map.objects().size(); ++i) {
    const std::size_t bytes = map.objects()[i].bytes;
    require(signed_of(again[i], bytes) == signed_of(values[i], bytes), "a value comes back");
  }
  const Frame heard = input.frame(kLikely, true);
  require(map.unpack(heard, again) == (is_canopen(heard) && heard.size >= map.bytes()), "a short frame is refused");
}

// Client and drive over a whole wire. The drive ends every transfer, and its numbers arrive.
void client_asks_a_drive(Input& input) {
  sim::SimCia402Params params;
  params.id = kNode;
  params.boot_ns = 0;
  sim::SimCia402 drive(params);
  SdoClient client(kNode);
  FrameQueue said;
  std::int64_t now_ns = 1'000'000'000;
  drive.on_time(now_ns, said);
  drive.on_time(now_ns, said);
  for (int i = 0; i < kMostSteps / 2 && !input.empty(); ++i) {
    const bool writes = input.byte() % 2 != 0;
    const Address address{input.number<std::uint16_t>(), input.byte()};
    const std::size_t bytes = 1 + input.byte() % 4;
    writes ? client.write(address, input.number<std::uint32_t>(), bytes) : client.read(address);
    Frame frame;
    for (int turn = 0; turn < 40 && client.outcome() == Outcome::busy; ++turn) {
      said.clear();
      if (client.next(now_ns, frame)) drive.on_frame(frame, now_ns, said);
      for (; const Frame* each = said.front(); said.pop()) client.on_frame(*each);
    }
    require(client.outcome() == Outcome::done || client.outcome() == Outcome::failed, "a drive ends every transfer");
    require(client.abort() != abort_code::kTimedOut, "a drive answers every request");
    const auto slot = drive.dictionary().find(address);
    if (client.outcome() != Outcome::done || !slot) continue;
    require(writes ? drive.dictionary().writable(*slot) : client.data().size() == drive.dictionary().bytes(*slot),
            "an object is read in its length, and written where that is allowed");
    if (!writes) require(client.value() == drive.dictionary().raw(*slot), "an object is read as the dictionary has it");
  }
}

}  // namespace

void run(Bytes bytes) {
  Input input(bytes);
  switch (input.byte() % 4) {
    case 0:
      return client_hears(input);
    case 1:
      return other_frames(input);
    case 2:
      return process_data(input);
    default:
      return client_asks_a_drive(input);
  }
}

std::vector<Seed> seeds() {
  std::vector<Seed> all;
  const std::array<std::uint8_t, 7> text{'a', 'b', 'c', 'd', 'e', 'f', 'g'};
  const auto hears = [](Script& script, const Frame& frame) {
    script.byte(6).number<std::uint16_t>(0).byte(0).frame(frame);
  };
  for (const std::uint16_t index : List<std::uint16_t>{0x1000, 0x1008, 0x6064}) {
    Script expedited, segmented, refused;
    for (Script* script : {&expedited, &segmented, &refused}) script->byte(0).byte(0).number(index).byte(0);
    hears(expedited, sdo_read_answer(kNode, {index, 0}, 0x12345678, 4));
    hears(segmented, sdo_long_answer(kNode, {index, 0}, 20));
    for (int i = 0; i < 12; ++i)
      segmented.byte(4).number(index).byte(0).frame(sdo_segment_answer(kNode, i % 2 != 0, text, i == 11));
    hears(refused, sdo_abort(0x585, {index, 0}, abort_code::kNoObject));
    all.insert(all.end(), {expedited, segmented, refused});
    all.push_back(Script().byte(0).byte(1).number(index).byte(0).number(7U).byte(6).number(index).byte(0).frame(
        sdo_written_answer(kNode, {index, 0})));
  }
  Script others, asks, process;
  others.byte(1);
  for (const std::uint8_t state : List<std::uint8_t>{0x00, 0x04, 0x05, 0x7f, 0x85, 0x11})
    others.frame(heartbeat_frame(kNode, NmtState{state})).byte(5).byte(20);
  others.frame(emergency_frame(kNode, {0x8130, 0x11})).byte(50).byte(20);
  process.byte(2);
  for (unsigned i = 0; i < 100; ++i) process.byte(i * 7);
  asks.byte(3);
  for (const std::uint16_t index : List<std::uint16_t>{0x1000, 0x1008, 0x1009, 0x1018, 0x1016, 0x1400, 0x1600, 0x1a00,
                                                       0x6040, 0x6041, 0x6060, 0x6064, 0x6076, 0x6502, 0x7777}) {
    asks.byte(0).number(index).byte(index == 0x1018 ? 1 : 0).byte(0);
    asks.byte(1).number(index).byte(index == 0x1400 ? 1 : 0).byte(index == 0x6040 ? 1 : 3).number(8U);
  }
  all.insert(all.end(), {others, process, asks});
  return all;
}

}  // namespace lithe::fuzz
