// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/scan/scan.hpp"

#include <algorithm>
#include <chrono>
#include <iterator>
#include <thread>
#include <utility>

#include "spine/core/time.hpp"
#include "spine/hal/canopen/canopen_sdo.hpp"
#include "supervisor/bus/plan/frame_time.hpp"

namespace lithe::bus {
namespace {

namespace canopen = hal::canopen;
namespace moteus = hal::moteus;

constexpr std::int64_t kBatchNs = 10 * kNsPerMs;  // for the answers of a few nodes
constexpr std::int64_t kLastNs = 150 * kNsPerMs;  // for those that take their time
constexpr std::uint32_t kBatch = 8;               // questions at once: no adapter's queue is shorter
constexpr std::uint32_t kLastNode = 127;
constexpr int kMostInVain = 20;  // attempts in a row in which the bus accepts no question

// The question is sent twice, so that one lost frame does not make a drive missing. Two devices may give equal answers:
// the number of equal answers is the larger of the two rounds (a late answer may arrive in the second round).
std::vector<moteus::Found> discover_twice(moteus::Terminal& terminal) {
  std::vector<moteus::Found> first = terminal.discover();
  std::vector<moteus::Found> again = terminal.discover();
  std::sort(first.begin(), first.end());
  std::sort(again.begin(), again.end());
  std::vector<moteus::Found> all;
  std::set_intersection(first.begin(), first.end(), again.begin(), again.end(), std::back_inserter(all));
  for (const std::vector<moteus::Found>* heard : {&first, &again}) {
    for (const moteus::Found& one : *heard) {
      if (!std::binary_search(all.begin(), all.end(), one))
        all.insert(std::upper_bound(all.begin(), all.end(), one), one);
    }
  }
  return all;
}

void ask_moteus(Line& line, const Time& time) {
  moteus::Terminal terminal(*line.bus, {time.now_ns, time.pause});
  for (const moteus::Found& found : discover_twice(terminal)) {
    ObservedMoteus one{found, std::nullopt, ""};
    const Result<moteus::Identity> identity = terminal.identify(found);
    if (identity) {
      one.identity = *identity;
    } else {
      one.why_unknown = identity.message();
    }
    line.observed.moteus.push_back(std::move(one));
  }
}

// Receives frames for this long; `take` gets the answers to SDO requests.
void receive_for(Line& line, std::int64_t for_ns, const Time& time,
                 const std::function<bool(const hal::Frame&)>& finished) {
  const std::int64_t end_ns = time.now_ns() + for_ns;
  while (true) {
    hal::Frame frame;
    const bool heard = line.bus->receive(frame);
    if (heard && canopen::is_canopen(frame) && canopen::function_of(frame) == canopen::cob::kSdoAnswer) {
      if (finished(frame)) return;
    } else if (heard) {
      observe(frame, line.protocol, line.observed);
    }
    if (time.now_ns() >= end_ns) return;
    if (!heard) time.pause();
  }
}

constexpr const char* kNotAsked =
    "the bus takes no more questions: check wires, termination and bit rates, and whether it is too busy (lithe bus "
    "monitor); not asked are nodes ";
constexpr canopen::Address kDeviceType{canopen::object::kDeviceType, 0};

// An SDO abort is an answer too.
bool note_device_type(const hal::Frame& frame, BusObservation& observed) {
  if (frame.size != 8 || !(canopen::sdo_address(frame) == kDeviceType)) return false;
  ObservedNode& node = observed.nodes[canopen::node_of(frame)];
  ++node.answers;
  if ((frame.data[0] & 0xe0) == 0x40) node.device_type = canopen::get(frame.data.data() + 4, 4);
  return false;  // there may be more
}

// Reads one object of one node. Empty when it has no such object, or when a number was expected and it is longer than 4
// bytes.
std::optional<std::string> read_object(Line& line, std::uint32_t node, canopen::Address address, const Time& time) {
  canopen::SdoClient client(node);
  client.read(address);
  while (client.outcome() == canopen::SdoClient::Outcome::busy) {
    hal::Frame frame;
    if (client.next(time.now_ns(), frame)) {
      line.bus->begin(time.now_ns());
      line.bus->send(frame);
      line.bus->flush();
    }
    receive_for(line, kBatchNs, time,
                [&](const hal::Frame& answer) { return canopen::node_of(answer) == node && client.take(answer); });
  }
  if (client.outcome() != canopen::SdoClient::Outcome::done) return std::nullopt;
  const auto data = client.data();
  return std::string(data.begin(), data.end());
}

std::optional<std::uint32_t> read_number(Line& line, std::uint32_t node, std::uint8_t subindex, const Time& time) {
  const auto bytes = read_object(line, node, {canopen::object::kIdentity, subindex}, time);
  if (!bytes || bytes->empty() || bytes->size() > 4) return std::nullopt;
  return canopen::get(reinterpret_cast<const std::uint8_t*>(bytes->data()), bytes->size());
}

// Waits until a batch of questions and answers has passed: an interface with a full queue would refuse the next batch.
std::int64_t batch_ns(const Line& line) {
  const hal::FrameBits bits = hal::most_bits({.size = 8});
  return std::max(kBatchNs, 2 * kBatch * hal::duration_ns(bits, {line.bitrate, line.bitrate}));
}

// Finds the nodes. A question that the bus refuses is sent again.
void ask_all_nodes(Line& line, const Time& time) {
  const auto hear_for = [&](std::int64_t for_ns) {
    receive_for(line, for_ns, time,
                [&line](const hal::Frame& answer) { return note_device_type(answer, line.observed); });
  };
  std::uint32_t node = 1;
  for (int in_vain = 0; node <= kLastNode && in_vain < kMostInVain;) {
    const std::uint32_t first = node;
    line.bus->begin(time.now_ns());
    const auto ask_next = [&] { return line.bus->send(canopen::sdo_read_request(node, kDeviceType)); };
    while (node < first + kBatch && node <= kLastNode && ask_next()) ++node;
    line.bus->flush();
    in_vain = node == first ? in_vain + 1 : 0;
    hear_for(batch_ns(line));
  }
  hear_for(kLastNs);
  if (node <= kLastNode) line.observed.trouble = kNotAsked + std::to_string(node) + " to " + std::to_string(kLastNode);
}

void ask_canopen(Line& line, const Time& time) {
  ask_all_nodes(line, time);
  for (auto& [id, node] : line.observed.nodes) {
    if (node.answers == 0) continue;
    node.vendor = read_number(line, id, 1, time);
    node.product = read_number(line, id, 2, time);
    node.revision = read_number(line, id, 3, time);
    node.serial = read_number(line, id, 4, time);
    node.name = read_object(line, id, {canopen::object::kDeviceName, 0}, time).value_or("");
  }
}

}  // namespace

Time real_time() {
  return {[] { return monotonic_ns(); }, [] { std::this_thread::sleep_for(std::chrono::microseconds(200)); }};
}

void listen(std::vector<Line>& lines, std::int64_t for_ns, const Time& time) {
  const std::int64_t end_ns = time.now_ns() + for_ns;
  for (Line& line : lines) {
    if (line.bus != nullptr) line.bus->begin(time.now_ns());
  }
  while (time.now_ns() < end_ns) {
    bool heard = false;
    for (Line& line : lines) {
      hal::Frame frame;
      if (line.bus == nullptr || !line.bus->receive(frame)) continue;
      observe(frame, line.protocol, line.observed);
      heard = true;
    }
    if (!heard) time.pause();
  }
}

void ask(Line& line, const Time& time) {
  if (line.bus == nullptr) return;
  const bool ours = line.observed.commander.empty();
  if (ours && line.protocol == Protocol::moteus) ask_moteus(line, time);
  if (ours && line.protocol == Protocol::canopen) ask_canopen(line, time);
  line.bus->begin(time.now_ns());  // some adapters notice only here that nothing is sent
  if (std::string down = line.bus->why_down(); !down.empty()) line.observed.trouble = std::move(down);
}

}  // namespace lithe::bus
