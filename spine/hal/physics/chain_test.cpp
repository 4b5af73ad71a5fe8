// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/physics/chain.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <random>
#include <string>
#include <vector>

namespace lithe::hal::sim {
namespace {

constexpr double kStepS = 1e-9 * static_cast<double>(Plant::kStepNs);
const std::vector<double> kNoTorque;

ChainParams chain_of(std::size_t count, unsigned seed = 1) {
  std::mt19937 random(seed);
  const auto between = [&](double low, double high) {
    return low + (high - low) * static_cast<double>(random() % 1000) / 1000;
  };
  ChainParams params;
  for (std::size_t i = 0; i < count; ++i) {
    ChainLink link;
    link.length_m = between(0.1, 0.4);
    link.center_m = between(0.05, 0.3);
    link.mass_kg = between(0.1, 1.0);
    link.inertia_kg_m2 = between(1e-3, 1e-2);
    link.rotor_inertia_kg_m2 = between(0, 3e-3);
    params.links.push_back(link);
  }
  return params;
}

// The same physics from another book: mass matrix by Jacobians, elimination, all in absolute angles.
std::vector<double> accelerations(const ChainParams& params, const std::vector<double>& q, const std::vector<double>& v,
                                  const std::vector<double>& torque) {
  const std::size_t n = q.size();
  std::vector<std::vector<double>> m(n, std::vector<double>(n + 1, 0.0));
  for (std::size_t i = 0; i < n; ++i) m[i][n] = torque[i];
  for (std::size_t body = 0; body < n; ++body) {
    // Way from each joint to this body's centre, and the centre's acceleration by turning alone.
    std::vector<double> x(n, 0.0), y(n, 0.0);
    double ax = 0, ay = params.gravity_m_s2, angle = 0, turn = 0;
    for (std::size_t i = 0; i <= body; ++i) {
      angle += q[i];
      turn += v[i];
      const double reach = i == body ? params.links[i].center_m : params.links[i].length_m;
      for (std::size_t k = 0; k <= i; ++k) {
        x[k] += reach * std::sin(angle);
        y[k] -= reach * std::cos(angle);
      }
      ax -= turn * turn * reach * std::sin(angle);
      ay += turn * turn * reach * std::cos(angle);
    }
    const double mass = params.links[body].mass_kg;
    for (std::size_t i = 0; i <= body; ++i) {
      for (std::size_t k = 0; k <= body; ++k)
        m[i][k] += mass * (x[i] * x[k] + y[i] * y[k]) + params.links[body].inertia_kg_m2;
      m[i][n] -= mass * (-y[i] * ax + x[i] * ay);
    }
  }
  for (std::size_t i = 0; i < n; ++i) m[i][i] += params.links[i].rotor_inertia_kg_m2;
  for (std::size_t i = 0; i < n; ++i) {  // positive definite: needs no pivot
    for (std::size_t k = i + 1; k < n; ++k) {
      const double share = m[k][i] / m[i][i];
      for (std::size_t j = i; j <= n; ++j) m[k][j] -= share * m[i][j];
    }
  }
  std::vector<double> a(n);
  for (std::size_t i = n; i-- > 0;) {
    a[i] = m[i][n];
    for (std::size_t j = i + 1; j < n; ++j) a[i] -= m[i][j] * a[j];
    a[i] /= m[i][i];
  }
  return a;
}

TEST(Chain, AcceleratesAsTheMassMatrixSaysForAnyLength) {
  std::mt19937 random(5);
  const auto noise = [&] { return static_cast<double>(random() % 2001) / 1000 - 1; };
  for (const std::size_t n : {1U, 2U, 3U, 5U, 12U, 32U}) {
    for (int round = 0; round < 20; ++round) {
      const ChainParams params = chain_of(n, static_cast<unsigned>(random()));
      Chain chain(params);
      std::vector<double> q(n), v(n), torque(n);
      for (std::size_t i = 0; i < n; ++i) {
        q[i] = 3 * noise();
        v[i] = 4 * noise();
        torque[i] = noise();
        chain.place(i, q[i], v[i]);
      }
      chain.step(torque);
      const std::vector<double> expected = accelerations(params, q, v, torque);
      double largest = 1;
      for (const double each : expected) largest = std::max(largest, std::abs(each));
      for (std::size_t i = 0; i < n; ++i)
        EXPECT_NEAR((chain.velocity_rad_s(i) - v[i]) / kStepS, expected[i], 1e-7 * largest) << n << " " << i;
    }
  }
}

// Two rods, written down as every textbook does.
TEST(Chain, TwoLinksAccelerateAsTheClosedFormSays) {
  ChainParams params = chain_of(2);
  const ChainLink& one = params.links[0];
  const ChainLink& two = params.links[1];
  for (const double q2 : {-2.0, -0.3, 0.0, 1.1, 2.9}) {
    const double q1 = 0.7, v1 = 1.5, v2 = -2.5, tau1 = 0.3, tau2 = -0.1;
    Chain chain(params);
    chain.place(0, q1, v1);
    chain.place(1, q2, v2);
    chain.step(std::vector<double>{tau1, tau2});
    const double reach = two.mass_kg * one.length_m * two.center_m;
    const double far = two.inertia_kg_m2 + two.mass_kg * two.center_m * two.center_m;
    const double near = one.inertia_kg_m2 + one.mass_kg * one.center_m * one.center_m +
                        two.mass_kg * one.length_m * one.length_m + far + one.rotor_inertia_kg_m2;
    const double m11 = near + 2 * reach * std::cos(q2), m12 = far + reach * std::cos(q2);
    const double m22 = far + two.rotor_inertia_kg_m2;
    const double g2 = two.mass_kg * two.center_m * 9.81 * std::sin(q1 + q2);
    const double g1 = (one.mass_kg * one.center_m + two.mass_kg * one.length_m) * 9.81 * std::sin(q1) + g2;
    const double b1 = tau1 + reach * std::sin(q2) * (2 * v1 * v2 + v2 * v2) - g1;
    const double b2 = tau2 - reach * std::sin(q2) * v1 * v1 - g2;
    const double det = m11 * m22 - m12 * m12;
    EXPECT_NEAR((chain.velocity_rad_s(0) - v1) / kStepS, (m22 * b1 - m12 * b2) / det, 1e-7);
    EXPECT_NEAR((chain.velocity_rad_s(1) - v2) / kStepS, (m11 * b2 - m12 * b1) / det, 1e-7);
  }
}

TEST(Chain, OneLinkMovesAsAPlantDoes) {
  PlantParams plant_params;
  plant_params.viscous_nm_s_rad = 2e-4;
  plant_params.coulomb_nm = 0.0132;
  plant_params.cogging_nm = 0.01;
  plant_params.torque_lag_s = 1e-3;
  plant_params.torque_max_nm = 0.3;
  plant_params.initial_position_rad = 0.4;
  ChainLink link;
  link.mass_kg = 0.124;
  link.center_m = 0.1357;
  link.inertia_kg_m2 = 2.1e-4;
  link.rotor_inertia_kg_m2 = 5.6e-5;
  link.joint = plant_params;
  plant_params.mgl_nm = link.mass_kg * link.center_m * 9.81;
  plant_params.inertia_kg_m2 = link.inertia_kg_m2 + link.mass_kg * link.center_m * link.center_m + 5.6e-5;
  Plant plant(plant_params);
  Chain chain({9.81, {link}});
  for (int i = 0; i < 200'000; ++i) {
    const std::vector<double> torque{0.25 * std::sin(4e-4 * i) + 0.1 * std::sin(3e-3 * i)};
    plant.step(torque[0]);
    chain.step(torque);
    ASSERT_NEAR(chain.position_rad(0), plant.position_rad(), 1e-9) << i;
    ASSERT_NEAR(chain.velocity_rad_s(0), plant.velocity_rad_s(), 1e-7) << i;
    ASSERT_EQ(chain.torque_nm(0), plant.torque_nm()) << i;
  }
}

double energy(const ChainParams& params, const std::vector<double>& q, const std::vector<double>& v) {
  double sum = 0, x_speed = 0, y_speed = 0, height = 0, angle = 0, turn = 0;
  for (std::size_t i = 0; i < q.size(); ++i) {
    const ChainLink& link = params.links[i];
    angle += q[i];
    turn += v[i];
    const double vx = x_speed + turn * link.center_m * std::cos(angle);
    const double vy = y_speed + turn * link.center_m * std::sin(angle);
    sum += link.mass_kg * ((vx * vx + vy * vy) / 2 + 9.81 * (height - link.center_m * std::cos(angle)));
    sum += (link.inertia_kg_m2 * turn * turn + link.rotor_inertia_kg_m2 * v[i] * v[i]) / 2;
    x_speed += turn * link.length_m * std::cos(angle);
    y_speed += turn * link.length_m * std::sin(angle);
    height -= link.length_m * std::cos(angle);
  }
  return sum;
}

// The largest change of energy within that time, as a share of what there is to swing with.
double energy_drift(std::size_t links, double seconds) {
  const ChainParams params = chain_of(links);
  Chain chain(params);
  for (std::size_t i = 0; i < links; ++i) chain.place(i, i == 0 ? 1.8 : 0.3);
  std::vector<double> q(links), v(links), hanging(links, 0.0);
  double first = 0, worst = 0;
  for (int step = 0; step < static_cast<int>(seconds / kStepS); ++step) {
    for (std::size_t i = 0; i < links; ++i) {
      q[i] = chain.position_rad(i);
      v[i] = chain.velocity_rad_s(i) / 2;
    }
    chain.step(kNoTorque);
    for (std::size_t i = 0; i < links; ++i) v[i] += chain.velocity_rad_s(i) / 2;  // when the links are where q says
    if (step == 0) std::fill(v.begin(), v.end(), 0.0);
    const double now = energy(params, q, v);
    if (step == 0) first = now;
    worst = std::max(worst, std::abs(now - first));
  }
  return worst / (first - energy(params, hanging, hanging));
}

TEST(Chain, WithoutFrictionEnergyNeitherGrowsNorDrains) {
  EXPECT_LT(energy_drift(2, 60), 1e-3);
  EXPECT_LT(energy_drift(5, 10), 1e-3);
}

TEST(Chain, ALockedJointMakesTwoLinksOneBody) {
  ChainParams params = chain_of(2);
  params.links[1].joint.coulomb_nm = 1e6;
  Chain stiff(params);
  ChainParams single{9.81, {params.links[0]}};
  const ChainLink& outer = params.links[1];
  ChainLink& body = single.links[0];
  const double far = body.length_m + outer.center_m;
  const double mass = body.mass_kg + outer.mass_kg;
  const double center = (body.mass_kg * body.center_m + outer.mass_kg * far) / mass;
  body.inertia_kg_m2 += outer.inertia_kg_m2 + body.mass_kg * body.center_m * body.center_m + outer.mass_kg * far * far -
                        mass * center * center;
  body.mass_kg = mass;
  body.center_m = center;
  Chain one(single);
  stiff.place(0, 1.2);
  one.place(0, 1.2);
  for (int i = 0; i < 40'000; ++i) {
    stiff.step(kNoTorque);
    one.step(kNoTorque);
    ASSERT_NEAR(stiff.position_rad(0), one.position_rad(0), 1e-9) << i;
    ASSERT_EQ(stiff.position_rad(1), 0.0);
  }
}

TEST(Chain, DryFrictionHoldsAWholeArmUpToItsTorqueAndNotBeyond) {
  ChainParams params = chain_of(3);
  // What gravity asks of each joint of the stretched-out arm.
  const std::vector<double> level{1.5707963267948966, 0.0, 0.0};
  std::vector<double> needed(3, 0.0);
  for (std::size_t body = 0; body < 3; ++body) {
    double reach = params.links[body].center_m;
    for (std::size_t joint = body + 1; joint-- > 0;) {
      if (joint < body) reach += params.links[joint].length_m;
      needed[joint] += params.links[body].mass_kg * 9.81 * reach;
    }
  }
  for (const double share : {0.999, 1.001}) {
    for (std::size_t i = 0; i < 3; ++i) params.links[i].joint.coulomb_nm = i == 1 ? share * needed[i] : 2 * needed[i];
    Chain chain(params);
    for (std::size_t i = 0; i < 3; ++i) chain.place(i, level[i]);
    for (int i = 0; i < 20'000; ++i) chain.step(kNoTorque);
    EXPECT_EQ(chain.position_rad(1) == 0.0, share > 1) << share;
    EXPECT_EQ(chain.position_rad(2), 0.0);
  }
}

// Friction far stiffer than a step of 50 us takes energy all the same, from links of any weight.
TEST(Chain, ViscousFrictionOfAnySizeOnlySlowsDown) {
  for (const double viscous : {1e2, 1e4, 1e6}) {
    ChainParams params = chain_of(6);
    params.gravity_m_s2 = 0;
    for (std::size_t i = 0; i < 6; ++i) {
      params.links[i].joint.viscous_nm_s_rad = i % 2 == 0 ? viscous : 0.01 * viscous;
      params.links[i].mass_kg *= i < 3 ? 1 : 1e-3;
      params.links[i].inertia_kg_m2 *= i < 3 ? 1 : 1e-3;
      params.links[i].rotor_inertia_kg_m2 = 0;
    }
    Chain chain(params);
    for (std::size_t i = 0; i < 6; ++i) chain.place(i, 0.3, i % 2 == 0 ? 1 : -2);
    for (int i = 0; i < 20'000; ++i) {
      chain.step(kNoTorque);
      for (std::size_t j = 0; j < 6; ++j) ASSERT_LT(std::abs(chain.velocity_rad_s(j)), 30) << viscous << " " << i;
    }
    for (std::size_t j = 0; j < 6; ++j) EXPECT_NEAR(chain.velocity_rad_s(j), 0, 0.1) << viscous;
  }
}

TEST(Chain, WithFrictionItComesToRestAndStaysThere) {
  ChainParams params = chain_of(6);
  for (ChainLink& link : params.links) link.joint.coulomb_nm = 0.2;
  Chain chain(params);
  for (std::size_t i = 0; i < 6; ++i) chain.place(i, 0.8);
  for (int i = 0; i < 20'000 * 60; ++i) chain.step(kNoTorque);
  for (std::size_t i = 0; i < 6; ++i) EXPECT_EQ(chain.velocity_rad_s(i), 0.0) << i;
}

TEST(Chain, SameInputsGiveTheSameMotionToTheBit) {
  ChainParams params = chain_of(12);
  for (ChainLink& link : params.links) {
    link.joint.coulomb_nm = 0.05;
    link.joint.cogging_nm = 0.02;
    link.joint.torque_lag_s = 1e-3;
    link.joint.viscous_nm_s_rad = 1e-3;
  }
  Chain a(params);
  Chain b(params);
  std::vector<double> torque(12);
  for (int i = 0; i < 40'000; ++i) {
    for (std::size_t j = 0; j < 12; ++j) torque[j] = 2 * std::sin(1e-3 * i * static_cast<double>(j + 1));
    a.step(torque);
    b.step(torque);
    for (std::size_t j = 0; j < 12; ++j) ASSERT_EQ(a.position_rad(j), b.position_rad(j));
  }
}

// Prints; asserts no time.
TEST(Chain, CostOfATick) {
  for (const std::size_t n : {1U, 4U, 12U, 32U}) {
    ChainParams params = chain_of(n);
    for (ChainLink& link : params.links) {
      link.joint.coulomb_nm = 0.02;
      link.joint.torque_lag_s = 1e-3;
    }
    Chain chain(params);
    const std::vector<double> torque(n, 0.1);
    double best_ns = 1e18;
    for (int round = 0; round < 20; ++round) {
      const auto start = std::chrono::steady_clock::now();
      for (int i = 0; i < 20 * 20; ++i) chain.step(torque);
      const auto taken = std::chrono::steady_clock::now() - start;
      best_ns = std::min(best_ns, std::chrono::duration<double, std::nano>(taken).count() / 20);
    }
    RecordProperty("ns_" + std::to_string(n), static_cast<int>(best_ns));
    std::printf("%zu links: %.0f ns per tick of 1 ms\n", n, best_ns);
    EXPECT_TRUE(std::isfinite(chain.position_rad(n - 1)));
  }
}

TEST(Chain, BackAtItsStartItMovesAsANewOneDoes) {
  ChainParams params = chain_of(3);
  for (ChainLink& link : params.links) link.joint.initial_position_rad = 0.7;
  const std::vector<double> torque{0.3, -0.2, 0.1};
  Chain moved(params), fresh(params);
  for (int i = 0; i < 5000; ++i) moved.step(torque);
  moved.to_start();
  for (int i = 0; i < 5000; ++i) {
    moved.step(torque);
    fresh.step(torque);
    for (std::size_t j = 0; j < 3; ++j) ASSERT_EQ(moved.position_rad(j), fresh.position_rad(j)) << i;
  }
  EXPECT_NE(fresh.position_rad(0), 0.7);
}

}  // namespace
}  // namespace lithe::hal::sim
