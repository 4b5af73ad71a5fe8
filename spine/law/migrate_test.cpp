// SPDX-License-Identifier: Apache-2.0
#include "spine/law/migrate.hpp"

#include <gtest/gtest.h>

namespace {

struct Old {
  struct Params {};
  struct State {
    double integral_rad_s = 1;
    double count = 2;
    std::array<double, 3> window_nm{3, 4, 5};
    float gone = 6;
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
    std::array<double, 4> gone{};
  };
  static void step(const lithe::Tick&, const Params&, State&, lithe::Effort&) {}
};

constexpr LitheLaw kOld = lithe::describe<Old>("old");
constexpr LitheLaw kNew = lithe::describe<New>("new");

TEST(Migrate, CarriesFieldsByNameAndTypeAndLeavesTheOthers) {
  const lithe::law::Migration plan = lithe::law::plan_migration(kOld, kNew);
  EXPECT_EQ(plan.count, 2u);
  EXPECT_EQ(plan.bytes, 4 * sizeof(double));
  const Old::State from;
  New::State to;
  lithe::law::apply_migration(plan, reinterpret_cast<const std::byte*>(&from), reinterpret_cast<std::byte*>(&to));
  EXPECT_EQ(to.integral_rad_s, 1);
  EXPECT_EQ(to.window_nm, (std::array<double, 3>{3, 4, 5}));
  EXPECT_EQ(to.count, -1) << "a double must never be read as an int32";
  EXPECT_EQ(to.fresh, -2);
  EXPECT_EQ(to.gone, (std::array<double, 4>{}));
}

TEST(Migrate, SameStateIsCarriedWhole) {
  const lithe::law::Migration plan = lithe::law::plan_migration(kOld, kOld);
  EXPECT_EQ(plan.count, 4u);
  EXPECT_EQ(plan.bytes, 5 * sizeof(double) + sizeof(float));
}

}  // namespace
