// SPDX-License-Identifier: Apache-2.0
// Our moteus codec as a peer of others (bench/codec_cases.py defines the interface). argv names a file of cases. It
// first prints the frames written and the values read for all of them; then, for every line on the standard input, the
// time that this takes.
#include <array>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "spine/core/time.hpp"
#include "spine/hal/moteus/moteus_codec.hpp"

namespace {

using namespace lithe;
using namespace lithe::hal;
using moteus::Format;
using moteus::SubframeWriter;
using Json = nlohmann::json;

constexpr std::size_t kValues = 7;
constexpr int kPasses = 100;  // over all cases, so that reading the clock takes a negligible part of the time

struct Case {
  std::array<double, kValues> values{};
  Frame reply;
};

constexpr std::array<SubframeWriter::Choice, 8> kCommand{Format::float32, Format::float32, Format::float32,
                                                         Format::float32, Format::float32, Format::float32,
                                                         std::nullopt,    Format::float32};

void encode(const Case& each, Frame& frame) LITHE_RT {
  SubframeWriter writer(frame);
  constexpr double kPositionMode = 10;
  writer.write(Format::int8, moteus::reg::kMode, {&kPositionMode, 1});
  const auto& v = each.values;
  const std::array<double, kCommand.size()> values{v[0], v[1], v[2], v[3], v[4], v[5], 0, v[6]};
  writer.write_each(moteus::reg::kCommandPosition, kCommand, values);
  writer.read(Format::int8, moteus::reg::kMode, 1);
  writer.read(Format::float32, moteus::reg::kPosition, 3);
  writer.read(Format::int8, moteus::reg::kVoltage, 3);
}

// Mode, position, velocity, torque, voltage, temperature, fault.
std::array<double, kValues> parse(const Frame& frame) LITHE_RT {
  std::array<double, kValues> read{};
  moteus::SubframeReader reader(frame.payload());
  moteus::Subframe part;
  while (reader.next(part)) {
    if (part.kind != moteus::Kind::reply) continue;
    for (std::uint32_t i = 0; i < part.count; ++i) {
      const std::uint32_t number = part.start + i;
      const std::size_t at = number <= moteus::reg::kTorque ? number : number - moteus::reg::kVoltage + 4;
      if (at < read.size()) read[at] = part.value(i);
    }
  }
  return read;
}

std::vector<Case> read_cases(const char* path) {
  std::vector<Case> cases;
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);) {
    const Json json = Json::parse(line);
    Case each;
    for (std::size_t i = 0; i < kValues; ++i) each.values[i] = json["values"][i];
    const std::string hex = json["reply"];
    for (std::size_t i = 0; i + 1 < hex.size() && each.reply.size < kMaxPayload; i += 2)
      each.reply.data[each.reply.size++] = static_cast<std::uint8_t>(std::stoul(hex.substr(i, 2), nullptr, 16));
    cases.push_back(each);
  }
  return cases;
}

Json tell(const std::vector<Case>& cases) {
  Json frames = Json::array(), reads = Json::array();
  for (const Case& each : cases) {
    Frame frame;
    encode(each, frame);
    std::string hex;
    for (const std::uint8_t byte : frame.payload()) {
      char two[3];
      std::snprintf(two, sizeof two, "%02x", byte);
      hex += two;
    }
    frames.push_back(hex);
    reads.push_back(parse(each.reply));
  }
  return {{"frames", frames}, {"reads", reads}};
}

// Nanoseconds per case.
template <class Work>
double time_ns(const RawClock& clock, const std::vector<Case>& cases, Work work) {
  const std::int64_t began_ns = clock.now_ns();
  for (int pass = 0; pass < kPasses; ++pass)
    for (const Case& each : cases) work(each);
  return static_cast<double>(clock.now_ns() - began_ns) / (kPasses * static_cast<double>(cases.size()));
}

// The results are summed up and printed, so that the compiler does not remove the computation.
Json measure(const RawClock& clock, const std::vector<Case>& cases) {
  double sum = 0;
  Frame frame;
  const double encode_ns = time_ns(clock, cases, [&](const Case& each) {
    encode(each, frame);
    sum += frame.data[frame.size - 1];
  });
  const double parse_ns = time_ns(clock, cases, [&](const Case& each) { sum += parse(each.reply)[1]; });
  return {{"encode_ns", encode_ns}, {"parse_ns", parse_ns}, {"sum", sum}};
}

}  // namespace

int main(int argc, char** argv) {
  try {
    const auto cases = read_cases(argc > 1 ? argv[1] : "");
    if (cases.empty()) throw std::runtime_error("no cases; give the file that bench/codec_cases.py writes");
    const RawClock clock = RawClock::calibrate();
    std::cout << tell(cases) << std::endl;
    for (std::string line; std::getline(std::cin, line);) std::cout << measure(clock, cases) << std::endl;
  } catch (const std::exception& wrong) {
    std::fprintf(stderr, "bench_codec: %s\n", wrong.what());
    return 1;
  }
}
