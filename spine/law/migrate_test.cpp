// SPDX-License-Identifier: Apache-2.0
#include "spine/law/migrate.hpp"

#include <gtest/gtest.h>

#include <limits>

namespace {

struct Old {
  struct Params {};
  struct State {
    double integral_rad_s = 1;
    double count = 2;
    std::array<double, 3> window_nm{3, 4, 5};
    float gone = 6;
    std::array<double, 3> narrower_nm{7, 8, 9};
  };
  static void step(const lithe::Tick&, const Params&, State&, lithe::Effort&) {}
};

struct New {
  struct Params {};
  struct State {
    std::int32_t count = -1;  // same name, other type
    float fresh = -2;
    std::array<double, 3> window_nm{};
    double integral_rad_s = -3;
    std::array<double, 2> narrower_nm{};
  };
  static void step(const lithe::Tick&, const Params&, State&, lithe::Effort&) {}
};

constexpr LitheLaw kOld = lithe::describe<Old>("old");
constexpr LitheLaw kNew = lithe::describe<New>("new");

TEST(Migrate, CarriesFieldsByNameAndTypeAndLeavesTheOthers) {
  const lithe::law::Migration plan = lithe::law::plan_migration(kOld, kNew);
  EXPECT_EQ(plan.count, 2u);
  const Old::State from;
  New::State to;
  lithe::law::apply_migration(plan, reinterpret_cast<const std::byte*>(&from), reinterpret_cast<std::byte*>(&to));
  EXPECT_EQ(to.integral_rad_s, 1);
  EXPECT_EQ(to.window_nm, (std::array<double, 3>{3, 4, 5}));
  EXPECT_EQ(to.count, -1) << "a double must never be read as an int32";
  EXPECT_EQ(to.fresh, -2);
  EXPECT_EQ(to.narrower_nm, (std::array<double, 2>{}));
}

// The value in `To` after a law whose only field of the same name was `From{value}`.
template <class From, class To>
To followed(From value) {
  struct Before {
    struct Params {};
    struct State {
      From count{};
    };
    static void step(const lithe::Tick&, const Params&, State&, lithe::Effort&) {}
  };
  struct After {
    struct Params {};
    struct State {
      To count{};
    };
    static void step(const lithe::Tick&, const Params&, State&, lithe::Effort&) {}
  };
  static constexpr LitheLaw kBefore = lithe::describe<Before>("before");
  static constexpr LitheLaw kAfter = lithe::describe<After>("after");
  const typename Before::State from{value};
  typename After::State to;
  lithe::law::apply_migration(lithe::law::plan_migration(kBefore, kAfter), reinterpret_cast<const std::byte*>(&from),
                              reinterpret_cast<std::byte*>(&to));
  return to.count;
}

TEST(Migrate, AWiderTypeTakesTheValueOver) {
  EXPECT_EQ((followed<float, double>(1.5f)), 1.5);
  EXPECT_EQ((followed<std::int8_t, std::int16_t>(-7)), -7);
  EXPECT_EQ((followed<std::uint8_t, std::int16_t>(200)), 200);
  EXPECT_EQ((followed<std::int16_t, std::int64_t>(-30'000)), -30'000);
  EXPECT_EQ((followed<std::uint32_t, std::int64_t>(4'000'000'000u)), 4'000'000'000);
  EXPECT_EQ((followed<std::int32_t, double>(-2'000'000'000)), -2e9);
  EXPECT_EQ((followed<std::uint16_t, float>(65'535)), 65'535.f);
  EXPECT_EQ((followed<std::int64_t, std::int64_t>(-1)), -1);
}

TEST(Migrate, WhatCouldLoseSomethingStartsFromItsDefault) {
  EXPECT_EQ((followed<double, float>(1.5)), 0.f);
  EXPECT_EQ((followed<std::int32_t, float>(1)), 0.f) << "a float holds 24 bits";
  EXPECT_EQ((followed<std::int64_t, double>(1)), 0.0) << "a double holds 53";
  EXPECT_EQ((followed<std::int8_t, std::uint16_t>(1)), 0u) << "an unsigned type has no negative values";
  EXPECT_EQ((followed<std::uint64_t, std::int64_t>(1)), 0);
  EXPECT_EQ((followed<float, std::int64_t>(1)), 0);
  EXPECT_EQ((followed<bool, std::int32_t>(true)), 0);
}

TEST(Migrate, ALongerArrayKeepsItsDefaultsBehindTheOldOnes) {
  using Three = std::array<double, 3>;
  using Five = std::array<double, 5>;
  EXPECT_EQ((followed<Three, Five>({1, 2, 3})), (Five{1, 2, 3, 0, 0}));
  EXPECT_EQ((followed<std::array<float, 2>, Three>({1, 2})), (Three{1, 2, 0}));
  EXPECT_EQ((followed<double, Three>(4)), (Three{4, 0, 0}));
  EXPECT_EQ((followed<Five, Three>({1, 2, 3, 4, 5})), (Three{})) << "an array is never shortened";
}

TEST(Migrate, AnotherUnitIsAnotherField) {
  struct InDegrees {
    struct Params {};
    struct State {
      double error_deg = 0;
    };
    static void step(const lithe::Tick&, const Params&, State&, lithe::Effort&) {}
  };
  struct InRadians {
    struct Params {};
    struct State {
      double error_rad = 0;
    };
    static void step(const lithe::Tick&, const Params&, State&, lithe::Effort&) {}
  };
  static constexpr LitheLaw kDegrees = lithe::describe<InDegrees>("degrees");
  static constexpr LitheLaw kRadians = lithe::describe<InRadians>("radians");
  EXPECT_EQ(lithe::law::plan_migration(kDegrees, kRadians).count, 0u);
}

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();

TEST(Migrate, AFieldThatIsNoNumberStartsFromItsDefault) {
  EXPECT_EQ((followed<double, double>(kNan)), 0.0);
  EXPECT_EQ((followed<double, double>(kInf)), 0.0);
  EXPECT_EQ((followed<double, double>(-kInf)), 0.0);
  EXPECT_EQ((followed<double, double>(1e300)), 0.0) << "its square is infinite";
  EXPECT_EQ((followed<float, float>(-1e30f)), 0.f);
  EXPECT_EQ((followed<float, double>(std::numeric_limits<float>::quiet_NaN())), 0.0);
  EXPECT_EQ((followed<double, double>(1e17)), 1e17) << "a time in nanoseconds";
  EXPECT_EQ((followed<std::uint64_t, std::uint64_t>(~0ull)), ~0ull) << "every integer is a number";
  EXPECT_EQ((followed<std::array<double, 3>, std::array<double, 3>>({1, kNan, 3})), (std::array<double, 3>{}))
      << "a field is carried as a whole or not at all";
}

TEST(Migrate, SameStateIsCarriedWhole) {
  const lithe::law::Migration plan = lithe::law::plan_migration(kOld, kOld);
  EXPECT_EQ(plan.count, 5u);
}

}  // namespace
