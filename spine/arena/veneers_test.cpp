// SPDX-License-Identifier: Apache-2.0
#include "spine/arena/veneers.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <set>

#include "spine/arena/arena.hpp"

namespace lithe::arena {
namespace {

class Veneers : public testing::Test {
 protected:
  Veneers() {
    Result<int> memory = make_memory();
    if (memory) fd_ = *memory;
    Result<Arena> arena = memory ? Arena::attach_exec(fd_) : Result<Arena>(memory.error());
    if (arena)
      arena_ = std::make_unique<Arena>(std::move(*arena));
    else
      why_ = arena.message();
  }
  ~Veneers() override { close(fd_); }
  void SetUp() override {
    if (arena_ == nullptr) GTEST_SKIP() << why_;
  }

  // The function behind a name, reached the way a law reaches it.
  template <class Function>
  static Function* through_stub(std::string_view name) {
    for (std::size_t i = 0; i < veneers().size(); ++i)
      if (veneers()[i].name == name) return reinterpret_cast<Function*>(veneer_address(i));
    ADD_FAILURE() << "no veneer " << name;
    return nullptr;
  }
  template <class T>
  static bool same_bits(T a, T b) {
    return std::memcmp(&a, &b, sizeof a) == 0;
  }

  int fd_ = -1;
  std::unique_ptr<Arena> arena_;
  std::string why_;
};

constexpr double kInputs[] = {0.0, -0.0, 0.1, -0.7, 1.0, 2.5, -3.25, 1e-300, 710.0, 1e22, INFINITY, -INFINITY, NAN};

TEST_F(Veneers, MathsThroughStubsGivesTheSameBitsAsADirectCall) {
  const std::pair<const char*, double (*)(double)> one[] = {
      {"sin", ::sin},       {"cos", ::cos},     {"tan", ::tan},     {"asin", ::asin},   {"atan", ::atan},
      {"exp", ::exp},       {"log", ::log},     {"log1p", ::log1p}, {"sqrt", ::sqrt},   {"cbrt", ::cbrt},
      {"tgamma", ::tgamma}, {"erf", ::erf},     {"rint", ::rint},   {"floor", ::floor}, {"round", ::round},
      {"sinh", ::sinh},     {"atanh", ::atanh}, {"exp2", ::exp2}};
  for (const auto& [name, direct] : one) {
    auto* stub = through_stub<double(double)>(name);
    for (const double x : kInputs) EXPECT_TRUE(same_bits(stub(x), direct(x))) << name << "(" << x << ")";
  }
  const std::pair<const char*, double (*)(double, double)> two[] = {
      {"atan2", ::atan2}, {"pow", ::pow}, {"hypot", ::hypot}, {"fmod", ::fmod}, {"remainder", ::remainder}};
  for (const auto& [name, direct] : two) {
    auto* stub = through_stub<double(double, double)>(name);
    for (const double x : kInputs)
      for (const double y : kInputs) EXPECT_TRUE(same_bits(stub(x, y), direct(x, y))) << name << " " << x << " " << y;
  }
}

TEST_F(Veneers, FloatsIntegersAndPointersPassUnchanged) {
  auto* sinf_stub = through_stub<float(float)>("sinf");
  auto* lround_stub = through_stub<long(double)>("lround");
  for (const double x : kInputs) {
    EXPECT_TRUE(same_bits(sinf_stub(static_cast<float>(x)), ::sinf(static_cast<float>(x)))) << x;
    if (std::abs(x) < 1e9) EXPECT_EQ(lround_stub(x), ::lround(x));
  }
  double sine = 0, cosine = 0;
  through_stub<void(double, double*, double*)>("sincos")(0.3, &sine, &cosine);
  EXPECT_EQ(sine, std::sin(0.3));
  EXPECT_EQ(cosine, std::cos(0.3));
  EXPECT_EQ(through_stub<double(double, double, double)>("fma")(2, 3, 4), 10);
  char text[8] = "";
  through_stub<void*(void*, const void*, std::size_t)>("memcpy")(text, "copied", 7);
  EXPECT_STREQ(text, "copied");
}

TEST_F(Veneers, AbortTraps) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_DEATH(through_stub<void()>("abort")(), "");
}

TEST(VeneerList, NamesAreUniqueAndFunctionsAreThere) {
  std::set<std::string_view> names;
  for (const Veneer& veneer : veneers()) {
    EXPECT_TRUE(names.insert(veneer.name).second) << veneer.name;
    EXPECT_NE(veneer.function, nullptr) << veneer.name;
  }
}

TEST(VeneerList, AnImagesHashChangesWithEveryByteOfIt) {
  std::vector<std::byte> image(100);
  const std::uint64_t hash = image_hash(image);
  EXPECT_EQ(image_hash({}), veneers_hash()) << "the list of functions is where the hash begins";
  for (std::byte& byte : image) {
    byte ^= std::byte{1};
    EXPECT_NE(image_hash(image), hash);
    byte ^= std::byte{1};
  }
  EXPECT_EQ(image_hash(image), hash);
}

}  // namespace
}  // namespace lithe::arena
