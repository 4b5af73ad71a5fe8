// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/fdcanusb/sim_fdcanusb.hpp"

#include <fmt/format.h>

#include <charconv>

#include "spine/hal/bus/serial/words.hpp"

namespace lithe::hal::sim {

using fdcanusb::Request;
using fdcanusb::Sum;

namespace {

struct Setting {
  std::string_view name;
  double factory;
};
constexpr std::array<Setting, SimFdcanusb::kSettings> kTable{{{"bitrate", 1e6},
                                                              {"fd_bitrate", 5e6},
                                                              {"sample_point", 0.666},
                                                              {"fd_sample_point", 0.666},
                                                              {"automatic_retransmission", 1},
                                                              {"fdcan_frame", 1},
                                                              {"bitrate_switch", 1},
                                                              {"restricted_mode", 0},
                                                              {"bus_monitor", 0},
                                                              {"loopback", 0},
                                                              {"termination", 1},
                                                              {"autostart", 1},
                                                              {"autorecover", 0},
                                                              {"delay_compensation", 1},
                                                              {"tdc_offset", 13},
                                                              {"tdc_filter", 1},
                                                              {"cancel_all_ms", 50}}};
constexpr std::size_t kFdFrame = 5;
constexpr std::size_t kBitRateSwitch = 6;
constexpr std::size_t kAutostart = 11;
constexpr std::size_t kAutorecover = 12;

constexpr SimFdcanusb::Settings factory() {
  SimFdcanusb::Settings values{};
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = kTable[i].factory;
  return values;
}

std::string shown(double value) { return fmt::format("{:.7g}", value); }

}  // namespace

SimFdcanusb::SimFdcanusb() : SimAdapter(fdcanusb::kLongestLine), settings_(factory()), stored_(factory()) {}

void SimFdcanusb::restart() {
  sums_ = false;
  settings_ = stored_;
  on_ = settings_[kAutostart] != 0;
}

void SimFdcanusb::idle(std::int64_t now_ns, std::string& out) {
  if (settings_[kAutorecover] != 0) recover();
  time_to_bus(now_ns);
  if (on_) pass_on(out);
}

void SimFdcanusb::serve(std::string_view line, std::int64_t now_ns, std::string& out) {
  if (line.empty()) return;
  const Sum sum = fdcanusb::strip_sum(line);
  if (sum == Sum::wrong || (sum == Sum::absent && sums_)) return say("ERR checksum", out);
  sums_ = sums_ || sum == Sum::right;
  Request request;
  const fdcanusb::Defaults defaults{settings_[kFdFrame] != 0, settings_[kBitRateSwitch] != 0};
  if (const char* wrong = fdcanusb::parse_request(line, defaults, request))
    return say(std::string("ERR ") + wrong, out);
  handle(request, now_ns, out);
}

void SimFdcanusb::handle(const Request& request, std::int64_t now_ns, std::string& out) {
  switch (request.kind) {
    case Request::Kind::send:
    case Request::Kind::remote:
      if (!on_) return say("ERR not in BusOn state", out);
      say("OK", out);
      if (request.kind == Request::Kind::remote) return;
      to_bus(request.frame, now_ns);
      return pass_on(out);
    case Request::Kind::on:
    case Request::Kind::off:
      return switch_bus(request.kind == Request::Kind::on, out);
    case Request::Kind::status:
      if (!on_) return say("ERR not in BusOn", out);
      return say(bus_off() ? "lec=5 dlec=0 err=1 warn=1 busoff=1 pexc=0 tdc=13"
                           : "lec=0 dlec=0 err=0 warn=0 busoff=0 pexc=0 tdc=13",
                 out);
    case Request::Kind::config:
      return say(on_ ? "clk=85000000 np=1 nsjw=16 nts1=56 nts2=28 dp=1 dsjw=5 dts1=11 dts2=5" : "ERR not in BusOn",
                 out);
    case Request::Kind::conf:
      return configure(request.text, out);
    case Request::Kind::nothing:
      return;
  }
}

void SimFdcanusb::switch_bus(bool on, std::string& out) {
  if (on == on_) return say(on ? "ERR already in BusOn" : "ERR already in BusOff", out);
  on_ = on;
  if (on_) recover();
  say("OK", out);
}

void SimFdcanusb::configure(std::string_view words, std::string& out) {
  const std::string_view verb = next_field(words, ' ');
  if (verb == "write") stored_ = settings_;
  if (verb == "load") settings_ = stored_;
  if (verb == "default") settings_ = factory();
  if (verb == "write" || verb == "load" || verb == "default") return say("OK", out);
  const bool every = verb == "enumerate";
  if (every) {
    if (!words.empty() && words != "can") return say("ERR unknown group", out);
    for (std::size_t i = 0; i < kSettings; ++i)
      say("can." + std::string(kTable[i].name) + " " + shown(settings_[i]), out);
    return say("OK", out);
  }
  if (verb != "get" && verb != "set") return say("ERR unknown subcommand", out);
  if (next_field(words, '.') != "can") return say("ERR unknown group", out);
  const std::string_view name = next_field(words, ' ');
  for (std::size_t i = 0; i < kSettings; ++i) {
    if (name != kTable[i].name) continue;
    if (verb == "get") return say(shown(settings_[i]), out);
    double value = 0;
    const auto [end, wrong] = std::from_chars(words.data(), words.data() + words.size(), value);
    if (wrong != std::errc() || end != words.data() + words.size()) break;
    settings_[i] = value;
    return say("OK", out);
  }
  say(verb == "get" ? "ERR error reading" : "ERR error setting", out);
}

void SimFdcanusb::pass_on(std::string& out) {
  std::array<char, fdcanusb::kLongestLine> line{};
  while (const Frame* frame = answers().front()) {
    say({line.data(), fdcanusb::format_received(*frame, line)}, out);
    answers().pop();
  }
}

void SimFdcanusb::say(std::string_view text, std::string& out) const {
  std::array<char, fdcanusb::kLongestLine> line{};
  std::size_t length = text.copy(line.data(), line.size());
  // The space before the checksum also ends an empty data field.
  if (sums_) length = fdcanusb::append_sum(line, length);
  out.append(line.data(), length);
  out += "\r\n";
}

}  // namespace lithe::hal::sim
