// SPDX-License-Identifier: Apache-2.0
// Laws that compute with Eigen: each must pass every gate, and give what ordinary Eigen gives.
#include <dlfcn.h>
#include <gtest/gtest.h>

#include <functional>
#include <ostream>
#include <random>

#include "lawd/run/files.hpp"
#include "lawd/test/eigen_operations.hpp"
#include "lawd/test/lawd_rig.hpp"
#include "spine/law/resident.hpp"

namespace lithe::lawd {
namespace {

std::string with_eigen(const std::string& body) { return "#include <Eigen/Dense>\n" + LawText{.body = body}.source(); }

struct Operation {
  std::string name;
  std::function<double(double)> ordinary;  // by ordinary Eigen
};
void PrintTo(const Operation& operation, std::ostream* out) { *out << operation.name; }
using Largest = Operations<12>;
#define ONE(name) \
  Operation { #name, &Largest::name }
const Operation kOperations[] = {ONE(product), ONE(blocks),  ONE(triangles),  ONE(symmetric), ONE(triangular_solve),
                                 ONE(lu),      ONE(full_lu), ONE(inverse),    ONE(llt),       ONE(ldlt),
                                 ONE(qr),      ONE(svd),     ONE(pivoted_qr), ONE(tall_svd),  ONE(eigenvalues),
                                 ONE(geometry)};
#undef ONE

using EigenSizes = ServiceTest;
class EigenLaw : public ServiceTest, public ::testing::WithParamInterface<Operation> {};

TEST_P(EigenLaw, OfTwelveRowsIsAdmittedAndGivesWhatEigenGives) {
  std::string text = read_file(std::string(LITHE_LAWS_DIR) + "/../lawd/test/eigen_operations.hpp").value_or("");
  const std::string once = "#pragma once\n";
  ASSERT_NE(text.find(once), std::string::npos);
  text.erase(text.find(once), once.size());
  const LawText law{.body = "u.torque_nm[0] = Operations<12>::" + GetParam().name + "(t.position_rad[0]);"};
  const nlohmann::json reply = compile(service_, text + law.source());
  ASSERT_TRUE(reply["ok"]) << reply["text"];
  EXPECT_EQ(reply["warnings"], "");
  void* handle = dlopen(reply["object"].get<std::string>().c_str(), RTLD_NOW | RTLD_LOCAL);
  ASSERT_NE(handle, nullptr) << dlerror();
  law::Resident resident;
  law::reset_resident(resident, *static_cast<const LitheLaw*>(dlsym(handle, "lithe_law")));
  std::mt19937 random(5);
  for (int i = 0; i < 50; ++i) {
    Tick t;
    t.joints = 1;
    t.position_rad[0] = std::uniform_real_distribution(-2.0, 2.0)(random);
    Effort u;
    std::array<double, kMaxProbes> probes{};
    resident.step(t, u, probes);
    const double wanted = GetParam().ordinary(t.position_rad[0]);
    EXPECT_NEAR(u.torque_nm[0], wanted, 1e-8 * (1 + std::abs(wanted))) << t.position_rad[0];
  }
  dlclose(handle);
}
INSTANTIATE_TEST_SUITE_P(All, EigenLaw, ::testing::ValuesIn(kOperations),
                         [](const auto& instance) { return instance.param.name; });

TEST_F(EigenSizes, AMatrixWhoseSizeIsKnownAtRunTimeIsRefusedAtItsLine) {
  const auto body = [](const std::string& declared) {
    return declared + "\nm.setConstant(t.position_rad[0]);\nu.torque_nm[0] = (m * m).trace();";
  };
  const nlohmann::json refused = compile(service_, with_eigen(body("Eigen::MatrixXd m(t.joints, t.joints);")));
  EXPECT_EQ(refused.value("stage", ""), "admission") << refused;
  const std::string text = refused["text"];
  EXPECT_NE(text.find("law.cpp:7: error"), std::string::npos) << text;
  EXPECT_NE(text.find("Eigen::Matrix<double, 6, 6>"), std::string::npos) << text;
  EXPECT_TRUE(compile(service_, with_eigen(body("Eigen::Matrix<double, 6, 6> m;")))["ok"]);
}

}  // namespace
}  // namespace lithe::lawd
