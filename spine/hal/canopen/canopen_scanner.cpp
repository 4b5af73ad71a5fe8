// SPDX-License-Identifier: Apache-2.0

#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <map>
#include <optional>

#include "spine/core/text.hpp"
#include "spine/core/time.hpp"
#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/canopen/canopen_sdo.hpp"
#include "spine/hal/canopen/canopen_text.hpp"

namespace lithe::hal::canopen {
namespace {

constexpr std::int64_t kBatchNs = 10 * kNsPerMs;  // for the answers of a few nodes
constexpr std::int64_t kLastNs = 150 * kNsPerMs;  // for those that take their time
constexpr std::uint32_t kBatch = 8;               // questions at once: no adapter's queue is shorter
constexpr std::uint32_t kLastNode = 127;
constexpr int kMostInVain = 20;  // attempts in a row in which the bus accepts no question
constexpr Address kDeviceType{object::kDeviceType, 0};

// What is known about a node.
struct ObservedNode {
  std::uint32_t answers = 0;  // to one question for object 1000h; 2 = two nodes with this id
  std::optional<NmtState> heartbeat;
  std::optional<std::uint32_t> device_type;  // 1000h: the profile is its low half
  std::optional<std::uint32_t> vendor, product, revision, serial;
  std::string name;
};

std::string text_of(const ObservedNode& node) {
  std::string text;
  const auto add = [&text](const std::string& more) { text += (text.empty() ? "" : ", ") + more; };
  if (!node.name.empty()) add("'" + printable(node.name) + "'");
  if (node.device_type) add(fmt::format("profile {}", *node.device_type & 0xffff));
  if (node.vendor) add(fmt::format("vendor {:08x}h", *node.vendor));
  if (node.product) add(fmt::format("product {:08x}h", *node.product));
  if (node.revision) add(fmt::format("revision {:08x}h", *node.revision));
  if (node.serial) add(fmt::format("serial {:08x}h", *node.serial));
  if (node.heartbeat) add(fmt::format("heartbeat: {}", word(*node.heartbeat)));
  if (node.answers == 0) add("its heartbeat is all that is heard of it");
  return text;
}

// `finished` gets the answers to SDO requests.
void receive_for(const AskedBus& line, std::int64_t for_ns, const std::function<bool(const Frame&)>& finished) {
  const std::int64_t end_ns = line.time.now_ns() + for_ns;
  while (true) {
    Frame frame;
    const bool received = line.bus.receive(frame);
    if (received && is_canopen(frame) && function_of(frame) == cob::kSdoAnswer) {
      if (finished(frame)) return;
    } else if (received) {
      line.other(frame);
    }
    if (line.time.now_ns() >= end_ns) return;
    if (!received) line.time.pause();
  }
}

// Empty when the node has no such object.
std::optional<std::string> read_object(const AskedBus& line, std::uint32_t node, Address address) {
  SdoClient client(node);
  client.read(address);
  converse(
      line, node, [&](std::int64_t now_ns, Frame& frame) { return client.next(now_ns, frame); },
      [&](const Frame& answer) { return client.on_frame(answer); },
      [&] { return client.outcome() != SdoClient::Outcome::busy; });
  if (client.outcome() != SdoClient::Outcome::done) return std::nullopt;
  const auto data = client.data();
  return std::string(data.begin(), data.end());
}

// Of the identity object. Empty when it has no such number, or one of more than 4 bytes.
std::optional<std::uint32_t> read_number(const AskedBus& line, std::uint32_t node, std::uint8_t subindex) {
  const auto bytes = read_object(line, node, {object::kIdentity, subindex});
  if (!bytes || bytes->empty() || bytes->size() > 4) return std::nullopt;
  return little_endian(reinterpret_cast<const std::uint8_t*>(bytes->data()), bytes->size());
}

class CanopenScanner final : public Scanner {
 public:
  std::string on_frame(const Frame& frame) override {
    if (!is_canopen(frame)) return "";
    const std::uint32_t function = function_of(frame);
    NmtState state{};
    if (node_of(frame) != 0 && function == cob::kHeartbeat && parse_heartbeat(frame, state))
      nodes_[node_of(frame)].heartbeat = state;
    if (frame.id == cob::kNmt) return "a network command (NMT)";
    if (frame.id == cob::kSync) return "SYNC";
    if (function == cob::kSdoRequest) return "an SDO request";
    const bool rpdo =
        function >= cob::kRpdo1 && function < cob::kSdoAnswer && (function - cob::kRpdo1) % cob::kNextPdo == 0;
    return rpdo ? fmt::format("process data for node {}", node_of(frame)) : "";
  }

  std::string ask(const AskedBus& line) override {
    std::string error = ask_all_nodes(line);
    for (auto& [id, node] : nodes_) {
      if (node.answers == 0) continue;
      node.vendor = read_number(line, id, 1);
      node.product = read_number(line, id, 2);
      node.revision = read_number(line, id, 3);
      node.serial = read_number(line, id, 4);
      node.name = read_object(line, id, {object::kDeviceName, 0}).value_or("");
    }
    return error;
  }

  std::vector<FoundDevice> found(bool asked) const override {
    std::vector<FoundDevice> all;
    for (const auto& [id, node] : nodes_) {
      FoundDevice device{.id = id, .what = text_of(node)};
      if (node.device_type) device.profile = *node.device_type & 0xffff;
      if (node.answers > 1) {
        device.twice = fmt::format(
            "{} answers came to one question: several nodes have id {}; take one off the bus and "
            "give it another id (its switches, or its maker's tool)",
            node.answers, id);
      } else if (node.answers == 0 && asked) {
        device.unfit = "it does not answer SDO requests: switch it off and on";
      }
      all.push_back(std::move(device));
    }
    return all;
  }

 private:
  // A question that the bus refuses is sent again.
  std::string ask_all_nodes(const AskedBus& line) {
    // Until a batch of questions and answers has passed: an interface with a full queue would refuse the next batch.
    constexpr std::int64_t kMostBits = 135;  // of a classic frame with 8 bytes, all stuff bits and the pause after it
    const std::int64_t batch_ns = std::max(kBatchNs, 2 * kBatch * kMostBits * kNsPerS / line.bitrate);
    const auto note = [this](const Frame& answer) { return note_device_type(answer); };
    std::uint32_t node = 1;
    for (int in_vain = 0; node <= kLastNode && in_vain < kMostInVain;) {
      const std::uint32_t first = node;
      line.bus.begin(line.time.now_ns());
      const auto ask_next = [&] { return line.bus.send(sdo_read_request(node, kDeviceType)); };
      while (node < first + kBatch && node <= kLastNode && ask_next()) ++node;
      line.bus.flush();
      in_vain = node == first ? in_vain + 1 : 0;
      receive_for(line, batch_ns, note);
    }
    receive_for(line, kLastNs, note);
    if (node > kLastNode) return "";
    return fmt::format(
        "the bus takes no more questions: check wires, termination and bit rates, and whether it is too busy (lithe "
        "bus "
        "monitor); not asked are nodes {} to {}",
        node, kLastNode);
  }

  // An SDO abort is an answer too.
  bool note_device_type(const Frame& frame) {
    if (frame.size != 8 || !(sdo_address(frame) == kDeviceType)) return false;
    ObservedNode& node = nodes_[node_of(frame)];
    ++node.answers;
    if ((frame.data[0] & 0xe0) == 0x40) node.device_type = little_endian(frame.data.data() + 4, 4);
    return false;  // there may be more
  }

  std::map<std::uint32_t, ObservedNode> nodes_;
};

}  // namespace

void converse(const AskedBus& line, std::uint32_t node, const std::function<bool(std::int64_t now_ns, Frame&)>& next,
              const std::function<bool(const Frame&)>& take, const std::function<bool()>& over) {
  while (!over()) {
    Frame frame;
    if (next(line.time.now_ns(), frame)) {
      line.bus.begin(line.time.now_ns());
      line.bus.send(frame);
      line.bus.flush();
    }
    receive_for(line, kBatchNs, [&](const Frame& answer) { return node_of(answer) == node && take(answer); });
  }
}

std::unique_ptr<Scanner> make_scanner() { return std::make_unique<CanopenScanner>(); }

}  // namespace lithe::hal::canopen
