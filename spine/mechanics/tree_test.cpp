// SPDX-License-Identifier: Apache-2.0
// Mass matrix and torques against somebody else's mechanics, where it is at hand: MuJoCo of Debian 12, libmujoco-dev.
#include "spine/mechanics/tree.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <random>
#include <string>
#include <vector>

#ifdef LITHE_MUJOCO
#include <mujoco/mujoco.h>

#include <cstdio>
#include <fstream>
#endif

namespace lithe::mechanics {
namespace {

constexpr std::size_t kMost = std::min<std::size_t>(kMaxJoints, 12);

struct Dice {
  explicit Dice(unsigned seed) : random(seed) {}
  double between(double low, double high) { return std::uniform_real_distribution<double>(low, high)(random); }
  Vector vector(double size) { return {between(-size, size), between(-size, size), between(-size, size)}; }
  std::mt19937_64 random;
};

struct Turn {
  double w = 1, x = 0, y = 0, z = 0;  // a unit quaternion
  Matrix matrix() const {
    return {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
            {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
            {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}};
  }
};

Turn any_turn(Dice& dice) {
  const Vector axis = dice.vector(1);
  const double w = dice.between(0.1, 1), size = std::sqrt(w * w + dot(axis, axis));
  return {w / size, axis.x / size, axis.y / size, axis.z / size};
}

// A tree in space, with branches, and what MuJoCo has to be told of it.
struct AnyTree {
  struct Made {
    Link link;
    Turn rest, principal;
    Vector inertia;  // about the principal axes
  };
  explicit AnyTree(unsigned seed) {
    Dice dice(seed);
    const std::size_t joints = 1 + seed % kMost;
    gravity = dice.vector(10);
    for (std::size_t j = 0; j < joints; ++j) {
      Made& made = all.emplace_back();
      made.rest = any_turn(dice);
      made.principal = any_turn(dice);
      const double small = dice.between(1e-4, 2e-3), large = dice.between(2e-3, 4e-3);
      made.inertia = {large, large, small};
      const Matrix turn = made.principal.matrix();
      const Matrix diagonal{{large, 0, 0}, {0, large, 0}, {0, 0, small}};
      const Vector axis = dice.vector(1);
      made.link = {.parent = j == 0 || dice.random() % 8 == 0 ? Link::kBase : dice.random() % j,
                   .axis = 1 / std::sqrt(dot(axis, axis)) * axis,
                   .offset_m = dice.vector(0.3),
                   .rest = made.rest.matrix(),
                   .mass_kg = dice.between(0.1, 2),
                   .center_m = dice.vector(0.2),
                   .inertia_kg_m2 = turn * diagonal * turn.transposed(),
                   .rotor_kg_m2 = dice.between(0, 3e-3),
                   .viscous_nm_s_rad = dice.between(0, 0.05)};
    }
  }
  Tree tree() const {
    Tree tree;
    for (const Made& made : all) EXPECT_TRUE(tree.add(made.link));
    tree.set_gravity(gravity);
    return tree;
  }
  std::vector<Made> all;
  Vector gravity;
};

JointArray any_joints(Dice& dice, std::size_t joints, double size) {
  JointArray values{};
  for (std::size_t j = 0; j < joints; ++j) values[j] = dice.between(-size, size);
  return values;
}

#ifndef LITHE_MUJOCO

TEST(TreeMujoco, AgreesInMassAndTorque) {
  GTEST_SKIP() << "MuJoCo is not installed; apt-get install libmujoco-dev, then configure again";
}

#else

std::string list(const std::vector<double>& values) {
  std::string all;
  for (const double value : values) {
    char text[32];
    std::snprintf(text, sizeof text, "%.17g ", value);
    all += text;
  }
  return "'" + all + "'";
}
std::string words(const Vector& v) { return list({v.x, v.y, v.z}); }
std::string words(const Turn& t) { return list({t.w, t.x, t.y, t.z}); }

std::string body_of(const AnyTree& any, std::size_t j) {
  const AnyTree::Made& made = any.all[j];
  const Link& link = made.link;
  std::string text = "<body pos=" + words(link.offset_m) + " quat=" + words(made.rest) + "><joint name='j" +
                     std::to_string(j) + "' type='hinge' axis=" + words(link.axis) +
                     " armature=" + list({link.rotor_kg_m2}) + " damping=" + list({link.viscous_nm_s_rad}) +
                     "/><inertial pos=" + words(link.center_m) + " quat=" + words(made.principal) +
                     " mass=" + list({link.mass_kg}) + " diaginertia=" + words(made.inertia) + "/>";
  for (std::size_t child = j + 1; child < any.all.size(); ++child)
    if (any.all[child].link.parent == j) text += body_of(any, child);
  return text + "</body>";
}

struct Theirs {
  explicit Theirs(const AnyTree& any) {
    std::string bodies;
    for (std::size_t j = 0; j < any.all.size(); ++j)
      if (any.all[j].link.parent == Link::kBase) bodies += body_of(any, j);
    const std::string path = testing::TempDir() + "lithe_tree.xml";
    std::ofstream(path) << "<mujoco><option gravity=" << words(any.gravity) << "/><worldbody>" << bodies
                        << "</worldbody></mujoco>";
    char error[256] = "";
    model.reset(mj_loadXML(path.c_str(), nullptr, error, sizeof error));
    std::remove(path.c_str());
    why = error;
    if (model == nullptr) return;
    data.reset(mj_makeData(model.get()));
    for (std::size_t j = 0; j < any.all.size(); ++j) {
      const int id = mj_name2id(model.get(), mjOBJ_JOINT, ("j" + std::to_string(j)).c_str());
      place.push_back(static_cast<std::size_t>(model->jnt_dofadr[id]));  // MuJoCo's order is depth first
    }
  }
  std::unique_ptr<mjModel, decltype(&mj_deleteModel)> model{nullptr, mj_deleteModel};
  std::unique_ptr<mjData, decltype(&mj_deleteData)> data{nullptr, mj_deleteData};
  std::vector<std::size_t> place;
  std::string why;
};

TEST(TreeMujoco, AgreesInMassAndTorque) {
  double mass_off = 0, torque_off = 0;
  for (unsigned seed = 1; seed <= 60; ++seed) {
    const AnyTree any(seed);
    const std::size_t joints = any.all.size();
    Theirs theirs(any);
    ASSERT_NE(theirs.data, nullptr) << theirs.why;
    Tree tree = any.tree();
    Dice dice(seed + 1000);
    for (int state = 0; state < 20; ++state) {
      const JointArray q = any_joints(dice, joints, 3), v = any_joints(dice, joints, 15),
                       a = any_joints(dice, joints, 100);
      for (std::size_t j = 0; j < joints; ++j) {
        theirs.data->qpos[theirs.place[j]] = q[j];
        theirs.data->qvel[theirs.place[j]] = v[j];
      }
      mj_forward(theirs.model.get(), theirs.data.get());
      std::vector<double> full(joints * joints);
      mj_fullM(theirs.model.get(), full.data(), theirs.data->qM);
      Square mass{};
      JointArray torque{};
      tree.pose(q);
      tree.mass(mass);
      tree.torque(v, a, torque);
      for (std::size_t j = 0; j < joints; ++j) {
        const std::size_t row = theirs.place[j];
        double expected = theirs.data->qfrc_bias[row] - theirs.data->qfrc_passive[row];
        for (std::size_t k = 0; k < joints; ++k) {
          const double theirs_kg_m2 = full[row * joints + theirs.place[k]];
          mass_off = std::max(mass_off, std::abs(mass[j][k] - theirs_kg_m2));
          expected += theirs_kg_m2 * a[k];
        }
        torque_off = std::max(torque_off, std::abs(torque[j] - expected) / std::max(1.0, std::abs(expected)));
      }
    }
  }
  EXPECT_LT(mass_off, 1e-9);
  EXPECT_LT(torque_off, 1e-8);
}

#endif

// Without MuJoCo, too: the two algorithms agree with each other.
TEST(Tree, TorqueIsMassTimesAccelerationPlusBias) {
  for (unsigned seed = 1; seed <= 60; ++seed) {
    const AnyTree any(seed);
    const std::size_t joints = any.all.size();
    Tree tree = any.tree();
    Dice dice(seed);
    const JointArray q = any_joints(dice, joints, 3), v = any_joints(dice, joints, 15),
                     a = any_joints(dice, joints, 100);
    Square mass{}, lower{};
    JointArray torque{}, bias{};
    tree.pose(q);
    tree.mass(mass);
    tree.torque(v, a, torque);
    tree.torque(v, {}, bias);
    for (std::size_t j = 0; j < joints; ++j) torque[j] -= bias[j];
    ASSERT_TRUE(factor(joints, mass, lower));
    solve(joints, lower, torque);
    for (std::size_t j = 0; j < joints; ++j) EXPECT_NEAR(torque[j], a[j], 1e-6) << "tree " << seed << " joint " << j;
  }
}

// By hand: a pendulum of 0.5 kg at 0.4 m, level, turning about z.
TEST(Tree, APendulumIsWhatTheBookSays) {
  Tree tree;
  ASSERT_TRUE(tree.add({.mass_kg = 0.5, .center_m = {0.4, 0, 0}, .rotor_kg_m2 = 0.01, .viscous_nm_s_rad = 0.1}));
  tree.set_gravity({0, -10, 0});
  Square mass{};
  JointArray torque{};
  tree.pose({});
  tree.mass(mass);
  tree.torque({3}, {2}, torque);
  EXPECT_NEAR(mass[0][0], 0.5 * 0.4 * 0.4 + 0.01, 1e-15);
  EXPECT_NEAR(torque[0], 2 * mass[0][0] + 0.5 * 10 * 0.4 + 0.1 * 3, 1e-12);
}

TEST(Tree, RefusesALinkWithoutPlaceOrEarlierParent) {
  Tree tree;
  EXPECT_FALSE(tree.add({.parent = 0}));
  for (std::size_t j = 0; j < kMaxJoints; ++j) EXPECT_TRUE(tree.add({}));
  EXPECT_FALSE(tree.add({}));
  EXPECT_EQ(tree.joints(), kMaxJoints);
}

TEST(Factor, RefusesAMatrixThatIsNotPositiveDefinite) {
  Square matrix{}, lower{};
  matrix[0] = {1, 2};
  matrix[1] = {2, 1};
  EXPECT_FALSE(factor(2, matrix, lower));
}

}  // namespace
}  // namespace lithe::mechanics
