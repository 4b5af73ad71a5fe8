// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/physics/coupling.hpp"

#include <algorithm>

#include "spine/core/joints.hpp"

namespace lithe::hal::sim {

bool Coupling::add(CoupledDrive& drive) {
  if (drives_.size() == mechanism_->joints()) return false;
  drives_.push_back(&drive);
  drive.plant().couple();
  follow(drives_.size() - 1);
  return true;
}

void Coupling::advance(std::int64_t now_ns) LITHE_RT {
  if (!started_) {
    started_ = true;
    time_ns_ = now_ns;
    for (CoupledDrive* drive : drives_) drive->advance(now_ns);  // starts their time grids together
  }
  const std::int64_t lag_ns = now_ns - time_ns_;
  if (lag_ns <= 0) return;
  const std::int64_t steps = std::min(lag_ns, CoupledDrive::kMaxCatchUpNs) / Plant::kStepNs;
  for (std::int64_t i = 0; i < steps; ++i) step();
  if (lag_ns <= CoupledDrive::kMaxCatchUpNs) return;
  time_ns_ += (now_ns - time_ns_) / Plant::kStepNs * Plant::kStepNs;
  for (CoupledDrive* drive : drives_) drive->skip(time_ns_);  // otherwise its controllers would wind up
}

void Coupling::step() LITHE_RT {
  time_ns_ += Plant::kStepNs;
  JointArray wanted_nm{};
  for (std::size_t i = 0; i < drives_.size(); ++i) {
    drives_[i]->advance(time_ns_);
    wanted_nm[i] = drives_[i]->plant().wanted_nm();
  }
  mechanism_->step({wanted_nm.data(), drives_.size()});
  for (std::size_t i = 0; i < drives_.size(); ++i) follow(i);
}

void Coupling::follow(std::size_t joint) LITHE_RT {
  drives_[joint]->plant().follow(mechanism_->position_rad(joint), mechanism_->velocity_rad_s(joint),
                                 mechanism_->torque_nm(joint));
}

}  // namespace lithe::hal::sim
