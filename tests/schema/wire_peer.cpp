// SPDX-License-Identifier: Apache-2.0
// The C++ side of tests/test_schema_roundtrip.py: one command per line on stdin, one line of answer. Values travel as
// hexadecimal numbers and never as memory, so that an offset which both sides have wrong alike would show.
#include <array>
#include <bit>
#include <cstdint>
#include <cstdlib>
#include <iostream>
#include <optional>
#include <sstream>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>

#include "spine/core/time.hpp"
#include "spine/ipc/segment.hpp"
#include "spine/wire/fields.hpp"

namespace lithe {
namespace {

template <class T>
struct Element {
  using Type = T;
};
template <class T, std::size_t N>
struct Element<std::array<T, N>> {
  using Type = T;
};

// The number whose hexadecimal digits stand for a value, and back.
template <class T>
std::uint64_t to_number(T value) {
  if constexpr (std::is_floating_point_v<T>)
    return std::bit_cast<std::uint64_t>(value);
  else
    return static_cast<std::make_unsigned_t<T>>(value);
}
template <class T>
T from_number(std::uint64_t number) {
  if constexpr (std::is_floating_point_v<T>)
    return std::bit_cast<T>(number);
  else
    return static_cast<T>(static_cast<std::make_unsigned_t<T>>(number));
}

template <class F, class Visit>
void for_each_element(F& field, Visit&& visit) {
  if constexpr (std::is_arithmetic_v<F>)
    visit(field);
  else
    for (auto& element : field) visit(element);
}

// "field:size:1f,2,3 field:..."
template <class T>
std::string describe(T message) {
  std::ostringstream out;
  out << std::hex;
  wire::for_each_field(message, [&](std::string_view name, auto& field) {
    using Type = typename Element<std::remove_reference_t<decltype(field)>>::Type;
    out << name << ':' << sizeof(Type);
    char separator = ':';
    for_each_element(field, [&](const Type& element) {
      out << separator << to_number(element);
      separator = ',';
    });
    out << ' ';
  });
  return out.str();
}

// All elements of all fields in order, each as one number.
template <class T>
T assemble(std::istream& numbers) {
  T message{};
  numbers >> std::hex;
  wire::for_each_field(message, [&](std::string_view, auto& field) {
    for_each_element(field, [&](auto& element) {
      std::uint64_t number = 0;
      numbers >> number;
      element = from_number<std::remove_reference_t<decltype(element)>>(number);
    });
  });
  return message;
}

std::string to_hex(const void* data, std::size_t size) {
  static constexpr char kDigits[] = "0123456789abcdef";
  std::string text;
  for (const unsigned char byte : std::string_view(static_cast<const char*>(data), size)) {
    text += kDigits[byte >> 4];
    text += kDigits[byte & 15];
  }
  return text;
}

template <class T>
T from_hex(const std::string& text) {
  T message{};
  auto* bytes = reinterpret_cast<unsigned char*>(&message);
  for (std::size_t i = 0; i < sizeof(T) && 2 * i + 1 < text.size(); ++i)
    bytes[i] = static_cast<unsigned char>(std::stoul(text.substr(2 * i, 2), nullptr, 16));
  return message;
}

template <class Memory>
ipc::Segment<Memory> make(const std::string& robot) {
  auto segment = ipc::Segment<Memory>::create(robot);
  if (!segment) {
    std::cerr << segment.message() << '\n';
    std::exit(1);
  }
  ipc::sign_in((*segment)->header, monotonic_ns());
  return std::move(*segment);
}

// The Spine's ends of the three segments.
class Spine {
 public:
  explicit Spine(const std::string& robot)
      : spine_(make<ipc::SpineMemory>(robot)), brain_(make<ipc::BrainMemory>(robot)) {}

  std::string set(const std::string& item, const std::string& hex) {
    if (item == "robot_info") ipc::ChannelWriter(spine_->robot_info).write(from_hex<wire::RobotInfo>(hex));
    if (item == "params") ipc::ChannelWriter(spine_->params).write(from_hex<wire::Params>(hex));
    if (item == "law_info") ipc::ChannelWriter(spine_->law_info[5]).write(from_hex<wire::LawInfo>(hex));
    if (item == "telemetry") ipc::RingWriter(spine_->telemetry).push(from_hex<wire::Telemetry>(hex));
    if (item == "events_tick") ipc::RingWriter(spine_->events_tick).push(from_hex<wire::Event>(hex));
    if (item == "bus") static_cast<wire::Histogram&>(spine_->bus) = from_hex<wire::Histogram>(hex);
    return "ok";
  }

  // Telemetry as fast as it goes; every number of a record is its tick, so that a torn one shows.
  std::string stream(std::uint64_t records) {
    ipc::RingWriter writer(spine_->telemetry);
    for (std::uint64_t tick = 1; tick <= records; ++tick) {
      wire::Telemetry record;
      record.tick = tick;
      record.position_rad.fill(static_cast<double>(tick));
      record.command_torque_nm.fill(static_cast<double>(tick));
      record.joint_status.fill(static_cast<std::uint32_t>(tick));
      writer.push(record);
    }
    return "ok";
  }

  std::string plan() {
    wire::Plan plan;
    return plan_.read(plan) ? to_hex(&plan, sizeof plan) : "none";
  }

  std::string receive(std::uint32_t result) {
    wire::Command letter;
    std::uint64_t ticket = 0;
    if (!commands_.receive(letter, ticket)) return "none";
    commands_.answer(ticket, result);
    return std::to_string(ticket) + ' ' + to_hex(&letter, sizeof letter);
  }

  std::string estop() { return std::to_string(brain_->estop.value); }

 private:
  ipc::Segment<ipc::SpineMemory> spine_;
  ipc::Segment<ipc::BrainMemory> brain_;
  ipc::ChannelReader<wire::Plan> plan_{brain_->plan};
  ipc::MailboxReceiver<wire::Command, wire::brain_segment::kCommandsDepth> commands_{brain_->commands,
                                                                                     spine_->brain_ack};
};

class Peer {
 public:
  std::string answer(const std::string& line) {
    std::istringstream words(line);
    std::string verb;
    std::string what;
    words >> verb;
    if (verb == "layout") return to_hex(&wire::kLayoutHash, sizeof wire::kLayoutHash);
    if (verb == "values" || verb == "bytes") return translate(verb, words);
    if (verb == "spine") {
      words >> what;
      spine_.emplace(what);
      return "ok";
    }
    if (!spine_) return "no spine";
    if (verb == "set") {
      std::string hex;
      words >> what >> hex;
      return spine_->set(what, hex);
    }
    std::uint64_t number = 0;
    words >> number;
    if (verb == "stream") return spine_->stream(number);
    if (verb == "receive") return spine_->receive(static_cast<std::uint32_t>(number));
    if (verb == "plan") return spine_->plan();
    return verb == "estop" ? spine_->estop() : "unknown verb";
  }

 private:
  // values MESSAGE <bytes as hex> -> what each field holds; bytes MESSAGE <numbers> -> the message as hex
  static std::string translate(const std::string& verb, std::istream& words) {
    std::string name;
    words >> name;
    std::string result = "unknown message";
    wire::for_each_message([&]<class T>(std::string_view candidate, T) {
      if (candidate != name) return;
      if (verb == "values") {
        std::string hex;
        words >> hex;
        result = describe(from_hex<T>(hex));
      } else {
        const T message = assemble<T>(words);
        result = to_hex(&message, sizeof message);
      }
    });
    return result;
  }

  std::optional<Spine> spine_;
};

}  // namespace
}  // namespace lithe

int main() {
  lithe::Peer peer;
  for (std::string line; std::getline(std::cin, line);) std::cout << peer.answer(line) << std::endl;
}
