// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia402/keys/cia402_keys.hpp"

#include <fmt/format.h>

#include "spine/robot/read/reader.hpp"

namespace lithe::hal::cia402 {

void read_keys(robot::Reader& in, Keys& keys, robot::Need need) {
  in.choice<Mode>("mode", keys.mode,
                  {{"torque", Mode::torque}, {"position", Mode::position}, {"velocity", Mode::velocity}});
  in.number("counts_per_rev", keys.counts_per_rev, {1.0, 1.0e9});
  in.number("rated_torque_nm", keys.rated_torque_nm, {1.0e-9, 1.0e6}, need);
}

void check_joint(robot::Reader& in, const Keys& keys, const robot::JointDemand& joint) {
  if (joint.power_limited && keys.mode != Mode::torque) {
    in.complain("power_max_w",
                fmt::format("\"{}\" closes its own loop (mode), so its power cannot be limited here: set 0, "
                            "or use mode = \"torque\"",
                            joint.device));
  }
  const double counts = joint.farthest_rev * keys.counts_per_rev;
  constexpr double kMostCounts = 2147483647.0;  // object 6064h has 32 bits
  if (counts <= kMostCounts) return;
  in.complain("ratio",
              fmt::format("the joint's range is {:.3g} counts of \"{}\", which counts to {:.3g}; set a coarser "
                          "unit in the drive (608Fh), and counts_per_rev to it",
                          counts, joint.device, kMostCounts));
}

}  // namespace lithe::hal::cia402
