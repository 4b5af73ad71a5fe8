// SPDX-License-Identifier: Apache-2.0
#include "lithe/law.hpp"

#include <gtest/gtest.h>

#include <array>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "spine/core/joints.hpp"  // must compile together with the contract in one file
#include "spine/law/resident.hpp"
#include "spine/law/sandbox.hpp"

namespace {

struct Filtered {
  struct Params {
    lithe::Param kp_nm_rad{4, 0, 40};
    lithe::Param cutoff_hz{20, 1, 100};
  };
  struct State {
    double integral_rad_s = 0.5;
    bool warm = true;
    lithe::JointArray filtered_rad_s{};
    std::array<float, 3> window_nm{1, 2, 3};
    std::uint16_t count = 7;
    std::int64_t last_ns = -1;
  };
  struct Probes {
    double error_rad = 0;
    double energy_j = 0;
  };
  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u, Probes& probes) {
    s.count = static_cast<std::uint16_t>(s.count + 1);
    probes.error_rad = t.setpoint_position_rad[0] - t.position_rad[0];
    u.torque_nm[0] = p.kp_nm_rad * probes.error_rad;
  }
};

struct Nested {
  struct Params {};
  struct Filter {
    double x_rad = 1;
    std::array<float, 2> y_nm{2, 3};
  };
  enum class Phase : std::uint8_t { rest, move };
  struct State {
    Filter filter;
    Phase phase = Phase::move;
    std::array<Filter, 2> each{};
    std::array<std::array<double, 3>, 11> row{};
  };
  static void step(const lithe::Tick&, const Params&, State&, lithe::Effort&) {}
};

struct Empty {
  struct Params {};
  struct State {};
  static void step(const lithe::Tick&, const Params&, State&, lithe::Effort&) {}
};

std::string text(const char (&field)[32]) { return std::string(field, strnlen(field, sizeof field)); }

constexpr LitheLaw kFiltered = lithe::describe<Filtered>("filtered");
constexpr LitheLaw kNested = lithe::describe<Nested>("nested");
constexpr LitheLaw kEmpty = lithe::describe<Empty>("empty");

TEST(Law, FieldsOfStructsAndRowsOfArraysHaveNamesOfTheirOwn) {
  const Nested::State s;
  const auto at = [&s](const void* field) {
    return static_cast<const char*>(field) - reinterpret_cast<const char*>(&s);
  };
  struct Wanted {
    std::string name;
    lithe::FieldKind kind;
    std::ptrdiff_t offset;
    std::uint32_t count;
  };
  std::vector<Wanted> wanted = {{"filter.x_rad", lithe::FieldKind::f64, at(&s.filter.x_rad), 1},
                                {"filter.y_nm", lithe::FieldKind::f32, at(&s.filter.y_nm), 2},
                                {"phase", lithe::FieldKind::u8, at(&s.phase), 1},
                                {"each[0].x_rad", lithe::FieldKind::f64, at(&s.each[0].x_rad), 1},
                                {"each[0].y_nm", lithe::FieldKind::f32, at(&s.each[0].y_nm), 2},
                                {"each[1].x_rad", lithe::FieldKind::f64, at(&s.each[1].x_rad), 1},
                                {"each[1].y_nm", lithe::FieldKind::f32, at(&s.each[1].y_nm), 2}};
  for (std::size_t i = 0; i < s.row.size(); ++i)
    wanted.push_back({"row[" + std::to_string(i) + "]", lithe::FieldKind::f64, at(&s.row[i]), 3});
  ASSERT_EQ(kNested.state_count, wanted.size());
  for (std::size_t i = 0; i < wanted.size(); ++i) {
    const LitheStateField& field = kNested.state[i];
    EXPECT_EQ(text(field.name), wanted[i].name);
    EXPECT_EQ(field.kind, static_cast<std::uint32_t>(wanted[i].kind)) << wanted[i].name;
    EXPECT_EQ(field.offset, static_cast<std::uint32_t>(wanted[i].offset)) << wanted[i].name;
    EXPECT_EQ(field.count, wanted[i].count) << wanted[i].name;
  }
}

TEST(Law, DescriptorNamesEveryStateFieldWithTypeAndRealOffset) {
  ASSERT_EQ(kFiltered.state_count, 6u);
  const Filtered::State s;
  const auto at = [&](const void* field) {
    return static_cast<std::uint32_t>(static_cast<const char*>(field) - reinterpret_cast<const char*>(&s));
  };
  const std::vector<std::uint32_t> offsets = {at(&s.integral_rad_s), at(&s.warm),  at(&s.filtered_rad_s),
                                              at(&s.window_nm),      at(&s.count), at(&s.last_ns)};
  const std::vector<std::string> names = {"integral_rad_s", "warm", "filtered_rad_s", "window_nm", "count", "last_ns"};
  const std::vector<lithe::FieldKind> kinds = {lithe::FieldKind::f64, lithe::FieldKind::boolean, lithe::FieldKind::f64,
                                               lithe::FieldKind::f32, lithe::FieldKind::u16,     lithe::FieldKind::i64};
  for (std::size_t i = 0; i < names.size(); ++i) {
    EXPECT_EQ(text(kFiltered.state[i].name), names[i]);
    EXPECT_EQ(kFiltered.state[i].offset, offsets[i]);
    EXPECT_EQ(kFiltered.state[i].kind, static_cast<std::uint32_t>(kinds[i]));
  }
  EXPECT_EQ(kFiltered.state[2].count, lithe::kMaxJoints);
  EXPECT_EQ(kFiltered.state[3].count, 3u);
}

TEST(Law, DescriptorCarriesParamsWithRangesAndProbesByName) {
  ASSERT_EQ(kFiltered.param_count, 2u);
  EXPECT_EQ(text(kFiltered.params[1].name), "cutoff_hz");
  EXPECT_EQ(kFiltered.params[1].value, 20);
  EXPECT_EQ(kFiltered.params[1].min, 1);
  EXPECT_EQ(kFiltered.params[1].max, 100);
  ASSERT_EQ(kFiltered.probe_count, 2u);
  EXPECT_EQ(text(kFiltered.probes[1]), "energy_j");
}

TEST(Law, LawWithoutStateParamsOrProbesIsALaw) {
  EXPECT_EQ(lithe::law::check_law(kEmpty), nullptr);
  EXPECT_EQ(kEmpty.state_size, 0u);
  EXPECT_EQ(kEmpty.param_count + kEmpty.probe_count + kEmpty.state_count, 0u);
}

// One instruction of AArch64 multiplies and adds, and rounds once: to -2^-60 here. This file is compiled optimised.
TEST(Arithmetic, AProductIsRoundedBeforeItIsAddedOnEveryMachine) {
  volatile double above = 1 + 0x1p-30, below = 1 - 0x1p-30, minus_one = -1;
  const double a = above, b = below, c = minus_one;
  EXPECT_EQ(a * b + c, 0);
}

TEST(Resident, StepRunsTheLawOnHostMemory) {
  lithe::law::Resident resident;
  lithe::law::reset_resident(resident, kFiltered);
  lithe::Tick tick;
  tick.joints = 1;
  tick.setpoint_position_rad[0] = 0.25;
  lithe::Effort effort;
  effort.torque_nm[0] = effort.kp_nm_rad[0] = 99;
  std::array<double, lithe::kMaxProbes> probes{};
  resident.step(tick, effort, probes);
  EXPECT_EQ(effort.torque_nm[0], 1.0);
  EXPECT_EQ(effort.kp_nm_rad[0], 0.0) << "the effort of the tick before must not remain in this one";
  EXPECT_TRUE(std::isnan(effort.position_rad[0]));
  EXPECT_EQ(probes[0], 0.25);
  std::uint16_t count = 0;
  std::memcpy(&count, resident.state.data() + kFiltered.state[4].offset, sizeof count);
  EXPECT_EQ(count, 8);
}

double half_of_smallest() {
  volatile double smallest = std::numeric_limits<double>::min();
  return smallest / 2;
}

struct Halves {
  struct Params {};
  struct State {};
  static void step(const lithe::Tick& t, const Params&, State&, lithe::Effort& u) {
    u.torque_nm[0] = half_of_smallest();
    u.torque_nm[1] = t.position_rad[0] * 0x1p1022;
  }
};
constexpr LitheLaw kHalves = lithe::describe<Halves>("halves");

TEST(Resident, ADenormalNumberIsZeroForALawOnly) {
  lithe::law::Resident resident;
  lithe::law::reset_resident(resident, kHalves);
  lithe::Tick tick;
  tick.joints = 2;
  tick.position_rad[0] = std::numeric_limits<double>::denorm_min();
  lithe::Effort effort;
  std::array<double, lithe::kMaxProbes> probes{};
  resident.step(tick, effort, probes);
  const auto sandbox = std::make_unique<lithe::law::Sandbox>();
  sandbox->enter(resident, tick);
  sandbox->call();
  for (const lithe::Effort& given : {effort, sandbox->effort}) {
    EXPECT_EQ(given.torque_nm[0], 0) << "as a result";
    EXPECT_EQ(given.torque_nm[1], 0) << "as an operand";
  }
  EXPECT_GT(half_of_smallest(), 0) << "for the caller";
}

TEST(Resident, ParamOutsideItsRangeOrNotANumberIsRefused) {
  lithe::law::Resident resident;
  lithe::law::reset_resident(resident, kFiltered);
  EXPECT_TRUE(resident.set_param(0, 40));
  EXPECT_FALSE(resident.set_param(0, 40.001));
  EXPECT_FALSE(resident.set_param(0, std::numeric_limits<double>::quiet_NaN()));
  EXPECT_FALSE(resident.set_param(2, 1));
  EXPECT_FALSE(resident.set_param(4000000000u, 1));
  EXPECT_EQ(resident.params[0].value, 40);
}

TEST(CheckLaw, EveryDamagedDescriptorIsNamed) {
  EXPECT_EQ(lithe::law::check_law(kFiltered), nullptr);
  const auto refused = [](auto damage) {
    LitheLaw law = kFiltered;
    damage(law);
    return lithe::law::check_law(law) != nullptr;
  };
  EXPECT_TRUE(refused([](LitheLaw& l) { l.magic = 0; }));
  EXPECT_TRUE(refused([](LitheLaw& l) { ++l.abi; }));
  EXPECT_TRUE(refused([](LitheLaw& l) { l.state_size = 5000; }));
  EXPECT_TRUE(refused([](LitheLaw& l) { l.state_count = 33; }));
  EXPECT_TRUE(refused([](LitheLaw& l) { l.probe_count = 9; }));
  EXPECT_TRUE(refused([](LitheLaw& l) { l.state[1].offset = l.state_size; }));
  EXPECT_TRUE(refused([](LitheLaw& l) { l.state[1].count = 0xFFFFFFFFu; }));
  EXPECT_TRUE(refused([](LitheLaw& l) { l.state[1].kind = 77; }));
  EXPECT_TRUE(refused([](LitheLaw& l) { l.params[0].max = -1; }));
  EXPECT_TRUE(refused([](LitheLaw& l) { std::memset(l.name, 'x', sizeof l.name); }));
  EXPECT_TRUE(refused([](LitheLaw& l) { std::memset(l.probes[0], 'x', sizeof l.probes[0]); }));
  EXPECT_TRUE(refused([](LitheLaw& l) { l.step = nullptr; }));
  EXPECT_TRUE(refused([](LitheLaw& l) { l.state_defaults = nullptr; }));
}

TEST(CheckLaw, EveryNameIsPrintable) {
  const auto refused = [](auto&& name, const char* text) {
    LitheLaw law = kFiltered;
    std::strncpy(name(law), text, 31);
    const char* why = lithe::law::check_law(law);
    return why != nullptr && std::string(why).find("not printable") != std::string::npos;
  };
  for (const char* text : {"a\x1b[31m", "a\nb",
                           "\xe2\x80\xae"
                           "a",
                           "\xff", "\xc0\xaf", "\xc2\x9b",
                           "\xd1\x80"
                           "d"}) {  // the last: a Cyrillic letter, as "pd" looks
    EXPECT_TRUE(refused([](LitheLaw& l) { return l.name; }, text));
    EXPECT_TRUE(refused([](LitheLaw& l) { return l.state[2].name; }, text));
    EXPECT_TRUE(refused([](LitheLaw& l) { return l.params[1].name; }, text));
    EXPECT_TRUE(refused([](LitheLaw& l) { return l.probes[1]; }, text));
  }
  EXPECT_FALSE(refused([](LitheLaw& l) { return l.name; }, "PD with 2 gains, {~}"));
}

TEST(CheckLaw, WrongAbiNamesExpectedAndFound) {
  LitheLaw law = kFiltered;
  law.abi = 9;
  char text[160];
  EXPECT_NE(std::string(lithe::law::describe_mismatch(law, text, sizeof text))
                .find("expected abi " + std::to_string(lithe::kLawAbi)),
            std::string::npos);
  EXPECT_NE(std::string(text).find("found abi 9"), std::string::npos) << text;
}

}  // namespace
