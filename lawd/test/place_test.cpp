// SPDX-License-Identifier: Apache-2.0
#include "lawd/object/link.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <memory>
#include <set>

#include "lawd/run/files.hpp"
#include "lawd/test/lawd_rig.hpp"
#include "spine/law/resident.hpp"

namespace lithe::lawd {
namespace {

using nlohmann::json;

// AddressSanitizer does not give back what is freed, for a while.
#if defined(__SANITIZE_ADDRESS__)
constexpr bool kFreedMemoryIsKept = true;
#elif defined(__has_feature)
constexpr bool kFreedMemoryIsKept = __has_feature(address_sanitizer);
#else
constexpr bool kFreedMemoryIsKept = false;
#endif

// A service with an arena of its own, in this process: what it places can be called here.
class PlaceTest : public testing::Test {
 protected:
  void SetUp() override {
    Result<int> memory = arena::make_memory();
    ASSERT_TRUE(memory) << memory.message();
    service_ = std::make_unique<Service>(cache_.path(), *memory);
    if (const json ping = ask({{"verb", "ping"}}); !ping["arena"]) GTEST_SKIP() << ping["arena_text"];
  }
  json ask(const json& request) { return lawd::ask(*service_, request); }
  // The hash of a law; admission is left out: what it refuses must be refused here as well.
  std::string compiled(const std::string& source) {
    const json reply = ask({{"verb", "compile"}, {"source", source}, {"joints", 2}, {"admit", false}});
    EXPECT_TRUE(reply["ok"]) << reply;
    return reply.value("hash", "");
  }
  json place(const std::string& hash, std::uint32_t slot) {
    return ask({{"verb", "place"}, {"hash", hash}, {"slot", slot}});
  }
  // Compiled, placed, ready to run.
  std::unique_ptr<law::Resident> resident(const LawText& text, std::uint32_t slot) {
    const json placed = place(compiled(text.source()), slot);
    EXPECT_TRUE(placed["ok"]) << placed;
    if (!placed["ok"]) return nullptr;
    auto resident = std::make_unique<law::Resident>();
    law::reset_resident(*resident, *reinterpret_cast<const LitheLaw*>(placed["entry"].get<std::uint64_t>()));
    return resident;
  }
  void expect_refused(const std::string& source, const std::string& words) {
    const json reply = place(compiled(source), 1);
    EXPECT_FALSE(reply["ok"]);
    EXPECT_EQ(reply["stage"], "place");
    EXPECT_NE(reply["text"].get<std::string>().find(words), std::string::npos) << reply;
  }

  TestCache cache_;
  std::unique_ptr<Service> service_;
  Tick tick_;
  Effort effort_;
  std::array<double, kMaxProbes> probes_{};
};

TEST_F(PlaceTest, PlacedLawStepsFromItsDefaultsInEverySlot) {
  LawText text;
  text.body = "s.sum_rad += 1; u.torque_nm[0] = p.kp_nm_rad * t.position_rad[0] + s.sum_rad;";
  text.state = "double sum_rad = 41;";
  tick_.joints = 2;
  tick_.position_rad[0] = 0.5;
  for (const std::uint32_t slot : {1u, 7u, arena::kSlots}) {
    const auto law = resident(text, slot);
    ASSERT_NE(law, nullptr);
    const auto at = reinterpret_cast<std::uint64_t>(law->descriptor);
    EXPECT_GE(at, arena::slot_address(slot));
    EXPECT_LT(at, arena::slot_address(slot) + arena::kSlotBytes);
    law->step(tick_, effort_, probes_);
    law->step(tick_, effort_, probes_);
    EXPECT_EQ(effort_.torque_nm[0], 0.5 + 43);
  }
}

TEST_F(PlaceTest, MathsOfAPlacedLawHasTheBitsOfADirectCall) {
  LawText text;
  text.body =
      "const double x = t.position_rad[0]; s.sum_rad += 0;"
      "u.torque_nm[0] = std::sin(x) + std::cos(x) * std::pow(2.5, x) - std::atan2(x, 3.0) + std::exp(-x * x);"
      "u.torque_nm[1] = std::sqrt(x * x + 1) + std::fmod(x, 0.3) + std::tanh(x) + std::lround(10 * x) +"
      "    static_cast<double>(std::sin(static_cast<float>(x)));";
  const auto law = resident(text, 2);
  ASSERT_NE(law, nullptr);
  tick_.joints = 2;
  for (int i = -100; i < 100; ++i) {
    const double x = 0.0371 * i;
    tick_.position_rad[0] = x;
    law->step(tick_, effort_, probes_);
    EXPECT_EQ(effort_.torque_nm[0],
              std::sin(x) + std::cos(x) * std::pow(2.5, x) - std::atan2(x, 3.0) + std::exp(-x * x));
    EXPECT_EQ(effort_.torque_nm[1], std::sqrt(x * x + 1) + std::fmod(x, 0.3) + std::tanh(x) +
                                        static_cast<double>(std::lround(10 * x)) +
                                        static_cast<double>(std::sin(static_cast<float>(x))));
  }
}

// AArch64 can multiply and add in one instruction, which rounds once: to -2^-60 here.
TEST_F(PlaceTest, AProductIsRoundedBeforeItIsAddedOnEveryMachine) {
  LawText text;
  text.body = "s.sum_rad += 0; u.torque_nm[0] = t.position_rad[0] * t.position_rad[1] + t.velocity_rad_s[0];";
  const auto law = resident(text, 2);
  ASSERT_NE(law, nullptr);
  tick_.joints = 2;
  tick_.position_rad[0] = 1 + 0x1p-30;
  tick_.position_rad[1] = 1 - 0x1p-30;
  tick_.velocity_rad_s[0] = -1;
  law->step(tick_, effort_, probes_);
  EXPECT_EQ(effort_.torque_nm[0], 0);
}

// Where a placed law's instructions come from, as a fault at each of them would be reported.
TEST_F(PlaceTest, EachLineOfALawIsFoundAgainFromItsPlaceInTheSlot) {
  LawText text;
  text.body =
      "\nu.torque_nm[0] = std::clamp(t.position_rad[0], -1.0, 1.0);\nif (t.joints > 20)\n*(volatile int*)8 = 1;\n";
  const std::string source = text.source(), hash = compiled(source);
  const auto line_of = [&](const std::string& words) {
    return 1 + std::count(source.begin(), source.begin() + static_cast<std::ptrdiff_t>(source.find(words)), '\n');
  };
  const json placed = place(hash, 3);
  ASSERT_TRUE(placed["ok"]) << placed;
  std::set<std::int64_t> lines;
  std::string function;
  for (std::uint32_t offset = 0; offset < 128; offset += 4) {
    const json told = ask({{"verb", "locate"}, {"hash", hash}, {"offset", offset}});
    if (told["ok"]) lines.insert(told["line"].get<std::int64_t>());
    if (told["ok"] && told["line"] == line_of("volatile")) function = told["function"];
  }
  EXPECT_TRUE(lines.contains(line_of("volatile")));
  EXPECT_EQ(function, "Law::step");
  EXPECT_TRUE(lines.contains(line_of("clamp"))) << "what is inlined belongs to the line that calls it";
  for (const std::int64_t line : lines) EXPECT_LE(line, 1 + std::count(source.begin(), source.end(), '\n'));
  const json far = ask({{"verb", "locate"}, {"hash", hash}, {"offset", 100'000}});
  EXPECT_EQ(far["stage"], "locate") << far;
}

TEST_F(PlaceTest, NonsenseIsNotLocated) {
  for (const json& request : {json{{"hash", "../../etc/passwd"}, {"offset", 0}}, json{{"hash", std::string(64, 'a')}},
                              json{{"hash", std::string(64, 'a')}, {"offset", -1}},
                              json{{"hash", std::string(64, 'a')}, {"offset", arena::kSlotBytes}}}) {
    json asked = request;
    asked["verb"] = "locate";
    EXPECT_EQ(ask(asked)["stage"], "request") << request;
  }
  const json unknown = ask({{"verb", "locate"}, {"hash", std::string(64, 'a')}, {"offset", 1}});
  EXPECT_FALSE(ask({{"verb", "locate"}, {"hash", std::string(64, 'a')}, {"offset", 1}, {"placed", false}})["ok"]);
  EXPECT_FALSE(unknown["ok"]);
}

TEST_F(PlaceTest, WhatCanBeWrittenIsRefusedByItsName) {
  LawText text;
  text.body = "total_rad += t.position_rad[0]; u.torque_nm[0] = total_rad;";
  const std::string with_global = "double total_rad = 0.5;\n" + text.source();
  expect_refused(with_global, "variable total_rad can be written");
  expect_refused("double total_rad;\n" + text.source(), "variable total_rad can be written");
  expect_refused("thread_local double total_rad = 1;\n" + text.source(), "variable total_rad can be written");
  text.body = "static int calls = 0; u.torque_nm[0] = ++calls % 2;";
  expect_refused(text.source(), "::calls can be written");
  text.body = "u.torque_nm[0] = *where;";
  expect_refused("double measured();\nconst double kAt[2] = {1, 2};\nconst double* where = kAt;\n" + text.source(),
                 "variable where can be written");
}

TEST_F(PlaceTest, CodeThatRunsAtStartIsRefused) {
  LawText text;
  text.body = "u.torque_nm[0] = 0;";
  expect_refused("__attribute__((constructor)) static void at_start() { asm volatile(\"\"); }\n" + text.source(),
                 "runs at start");
}

TEST_F(PlaceTest, FunctionOutsideTheListDoesNotExist) {
  LawText text;
  text.body = "u.torque_nm[0] = rand();";
  expect_refused("extern \"C\" int rand();\n" + text.source(), "the law uses rand");
}

TEST_F(PlaceTest, TableOfAQuarterMegabyteDoesNotFit) {
  LawText text;
  text.body = "u.torque_nm[0] = kTable[t.tick % 40000];";
  std::string source = text.source();
  source.insert(source.find("struct Law"),
                "constexpr auto kTable = [] { std::array<double, 40000> x{}; for (int i = 0; i < 40000; ++i) x[i] = i; "
                "return x; }();\n");
  expect_refused(source, "do not fit");
}

TEST_F(PlaceTest, RefusedLawLeavesItsSlotAsItWas) {
  const auto law = resident(LawText{}, 1);
  ASSERT_NE(law, nullptr);
  LawText text;
  text.body = "u.torque_nm[0] = total_rad += 1;";
  expect_refused("double total_rad = 0.5;\n" + text.source(), "total_rad");
  tick_.joints = 2;
  tick_.position_rad[0] = 2;
  law->step(tick_, effort_, probes_);
  EXPECT_EQ(effort_.torque_nm[0], 2);
}

TEST_F(PlaceTest, RequestsThatMakeNoSenseAreRefused) {
  const std::string hash = compiled(LawText{}.source());
  EXPECT_EQ(place(hash, 0)["stage"], "request");
  EXPECT_EQ(place(hash, arena::kSlots + 1)["stage"], "request");
  EXPECT_EQ(place("../../etc/passwd", 1)["stage"], "request");
  EXPECT_EQ(place(std::string(64, 'a'), 1)["stage"], "cache");
  EXPECT_EQ(ask({{"verb", "place"}})["stage"], "request");
}

TEST_F(PlaceTest, ObjectThatIsNotWhatWasAdmittedIsNotLinked) {
  const std::string hash = compiled(LawText{}.source()), file = cache_.path() + "/laws/" + hash + ".o";
  const std::string whole = *read_file(file);
  std::string flipped = whole;
  flipped[flipped.size() / 2] = static_cast<char>(flipped[flipped.size() / 2] ^ 1);
  for (const std::string& damaged : {flipped, whole.substr(0, 100), std::string()}) {
    std::ofstream(file, std::ios::binary) << damaged;
    EXPECT_EQ(place(hash, 1)["stage"], "cache");
  }
  std::ofstream(file, std::ios::binary) << whole;
  EXPECT_TRUE(place(hash, 1)["ok"]);
}

TEST_F(PlaceTest, SameLawInTheSameSlotIsTheSameImage) {
  const std::string hash = compiled(LawText{}.source());
  const json first = place(hash, 4), other = place(hash, 5), again = place(hash, 4);
  for (const char* key : {"entry", "code_bytes", "image_hash"}) EXPECT_EQ(first[key], again[key]) << key;
  EXPECT_NE(first["image_hash"], other["image_hash"]) << "linked for another address";
}

TEST_F(PlaceTest, ThousandPlacementsKeepMemoryFilesAndFoldersFlat) {
  namespace fs = std::filesystem;
  struct Use {
    long resident_kib = 0;
    std::ptrdiff_t descriptors = 0, files = 0;
  };
  const auto use = [&] {
    long pages = 0, resident = 0;
    std::FILE* statm = std::fopen("/proc/self/statm", "r");
    EXPECT_EQ(std::fscanf(statm, "%ld %ld", &pages, &resident), 2);
    std::fclose(statm);
    return Use{resident * sysconf(_SC_PAGESIZE) / 1024, std::distance(fs::directory_iterator("/proc/self/fd"), {}),
               std::distance(fs::recursive_directory_iterator(cache_.path()), {})};
  };
  LawText other;
  other.name = "other";
  const std::string laws[] = {compiled(LawText{}.source()), compiled(other.source())};
  Use before;
  for (std::uint32_t i = 0; i < 1000; ++i) {
    ASSERT_TRUE(place(laws[i % 2], 1 + i / 2 % arena::kSlots)["ok"]);
    if (i == 99) before = use();
  }
  const Use after = use();
  if (!kFreedMemoryIsKept)
    EXPECT_LE(after.resident_kib - before.resident_kib, 512) << "KiB more after another 900 placements";
  EXPECT_EQ(after.descriptors, before.descriptors);
  EXPECT_EQ(after.files, before.files);
}

TEST(PlaceWithoutArena, SaysSoAndCompilesAllTheSame) {
  TestCache cache;
  Service service(cache.path());
  const json made = compile(service, LawText{}.source());
  ASSERT_TRUE(made["ok"]) << made;
  const json reply = service.answer(json{{"verb", "place"}, {"hash", made["hash"]}, {"slot", 1}}.dump());
  EXPECT_EQ(reply["stage"], "arena");
  EXPECT_NE(reply["text"].get<std::string>().find("no code arena"), std::string::npos);
}

TEST(WhyNotPlaceable, AnyBytesAreSafe) {
  EXPECT_NE(why_not_placeable(""), "");
  EXPECT_NE(why_not_placeable(std::string(5000, 'x')), "");
}

}  // namespace
}  // namespace lithe::lawd
