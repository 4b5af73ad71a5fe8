// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: uncompilable
// gate: words
// Opens namespace lithe to change what the contract checks.
#include <lithe/law.hpp>

namespace lithe {
namespace contract {
template <>
struct Element<double*> {
  using type = double;
  static constexpr std::uint32_t count = 512;
};
}  // namespace contract
}  // namespace lithe

struct Hostile {
  struct Params {};
  struct State {
    double* where = nullptr;
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    }
  }
};
LITHE_LAW(Hostile, "specialises_the_contract");
