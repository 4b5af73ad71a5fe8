// SPDX-License-Identifier: Apache-2.0
// Our moteus codec for a test in another language: a JSON request a line, a JSON answer a line.
//   {"do": "encode", "parts": [{"kind": "write", "start": 32, "formats": [3, null], "values": ["0x1p-2", "0x0p+0"]}]}
//   {"do": "decode", "hex": "2100..."}
//   {"do": "drive", "params": {...}, "command": {...}}
// Formats: 0 int8, 1 int16, 2 int32, 3 float, null none. Numbers are text, so that none is rounded on the way.
#include <array>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "spine/hal/moteus/moteus.hpp"

namespace {

using namespace lithe::hal;
using moteus::Format;
using moteus::SubframeWriter;
using Json = nlohmann::json;

double number(const Json& text) { return std::strtod(text.get<std::string>().c_str(), nullptr); }

std::string text_of(double value) {
  std::array<char, 64> text{};
  std::snprintf(text.data(), text.size(), "%a", value);
  return text.data();
}

std::string hex_of(const Frame& frame) {
  std::string text;
  for (const std::uint8_t byte : frame.payload()) {
    text += "0123456789abcdef"[byte >> 4];
    text += "0123456789abcdef"[byte & 15];
  }
  return text;
}

std::vector<std::uint8_t> bytes_of(const std::string& hex) {
  std::vector<std::uint8_t> bytes;
  for (std::size_t i = 0; i + 1 < hex.size(); i += 2)
    bytes.push_back(static_cast<std::uint8_t>(std::stoul(hex.substr(i, 2), nullptr, 16)));
  return bytes;
}

std::vector<SubframeWriter::Choice> formats_of(const Json& list) {
  std::vector<SubframeWriter::Choice> formats;
  for (const Json& each : list)
    formats.push_back(each.is_null() ? SubframeWriter::Choice() : static_cast<Format>(each.get<int>()));
  return formats;
}

void encode_part(const Json& part, SubframeWriter& writer) {
  const std::string kind = part["kind"];
  if (kind == "data" || kind == "poll") {
    const auto bytes = bytes_of(part.value("hex", ""));
    kind == "data" ? writer.client_data(part["channel"], bytes) : writer.poll(part["channel"], part["most"]);
    return;
  }
  const auto formats = formats_of(part["formats"]);
  const std::uint32_t start = part["start"];
  if (kind == "read") return writer.read_each(start, formats);
  std::vector<double> values;
  for (const Json& each : part["values"]) values.push_back(number(each));
  if (kind == "write") return writer.write_each(start, formats, values);
  writer.reply(*formats[0], start, values, false);  // a drive answers in the format it was asked in
}

Json encode(const Json& request) {
  Frame frame;
  SubframeWriter writer(frame);
  for (const Json& part : request["parts"]) encode_part(part, writer);
  return {{"hex", hex_of(frame)}, {"ok", writer.ok()}};
}

Json decode(const Json& request) {
  const auto bytes = bytes_of(request["hex"]);
  moteus::SubframeReader reader(bytes);
  moteus::Subframe s;
  Json writes = Json::array(), replies = Json::array(), reads = Json::array(), errors = Json::array();
  while (reader.next(s)) {
    for (std::uint32_t i = 0; i < s.count; ++i) {
      if (s.kind == moteus::Kind::write) writes.push_back({s.start + i, text_of(s.value(i))});
      if (s.kind == moteus::Kind::reply) replies.push_back({s.start + i, text_of(s.value(i))});
      if (s.kind == moteus::Kind::read) reads.push_back({s.start + i, static_cast<int>(s.format)});
    }
    if (s.kind == moteus::Kind::read_error || s.kind == moteus::Kind::write_error) errors.push_back({s.start, s.error});
  }
  return {{"writes", writes}, {"replies", replies}, {"reads", reads}, {"errors", errors}, {"ok", reader.well_formed()}};
}

Json drive(const Json& request) {
  const Json& p = request["params"];
  const auto formats = formats_of(p["formats"]);
  moteus::DriverParams params{.id = p["id"], .watchdog_s = number(p["watchdog_s"]), .joint = {}};
  params.frames = {*formats[0], *formats[1], formats[2], formats[3], !p["settings"].get<bool>()};
  const Json& j = request["command"];
  JointCommand command;
  command.action = static_cast<DriveAction>(j["action"].get<int>());
  command.target_rad = number(j["position_rad"]);
  command.target_rad_s = number(j["velocity_rad_s"]);
  command.torque_nm = number(j["torque_nm"]);
  command.kp_nm_rad = number(j["kp_nm_rad"]);
  command.kd_nm_s_rad = number(j["kd_nm_s_rad"]);
  command.max_torque_nm = number(j["max_torque_nm"]);
  const moteus::MoteusDrive driver(params);
  Frame frame;
  const bool sound = driver.encode(command, 0, frame);
  return {{"hex", hex_of(frame)}, {"id", frame.id}, {"ok", sound}};
}

Json answer(const Json& request) {
  const std::string what = request["do"];
  return what == "encode" ? encode(request) : what == "decode" ? decode(request) : drive(request);
}

}  // namespace

int main() {
  try {
    for (std::string line; std::getline(std::cin, line);) std::cout << answer(Json::parse(line)) << '\n';
  } catch (const std::exception& wrong) {
    std::fprintf(stderr, "frames_peer: %s\n", wrong.what());
    return 1;
  }
}
