// SPDX-License-Identifier: Apache-2.0
#include "spine/law/sandbox.hpp"

#include <cerrno>
#include <new>
#include <string>
#include <utility>

namespace lithe::law {
void Sandbox::enter(const Resident& law, const Tick& in) LITHE_RT {
  const std::uint32_t joints = std::min<std::uint32_t>(in.joints, kMaxJoints);
  tick.tick = in.tick;
  tick.t_ns = in.t_ns;
  tick.t_s = in.t_s;
  tick.dt_s = in.dt_s;
  tick.joints = joints;
  tick.flags = in.flags;
  tick.sample_age_s = in.sample_age_s;
  tick.brain_age_s = in.brain_age_s;
  copy_joints(in.position_rad, tick.position_rad, joints);
  copy_joints(in.velocity_rad_s, tick.velocity_rad_s, joints);
  copy_joints(in.torque_nm, tick.torque_nm, joints);
  copy_joints(in.setpoint_position_rad, tick.setpoint_position_rad, joints);
  copy_joints(in.setpoint_velocity_rad_s, tick.setpoint_velocity_rad_s, joints);
  copy_joints(in.setpoint_acceleration_rad_s2, tick.setpoint_acceleration_rad_s2, joints);
  tick.sensor = in.sensor;
  tick.input = in.input;
  tick.input_age_s = in.input_age_s;
  const LitheLaw& descriptor = *law.descriptor;
  std::memcpy(params.data(), law.params.data(),
              std::min<std::size_t>(descriptor.param_count, kMaxParams) * sizeof(Param));
  std::memcpy(state.data(), law.state.data(), std::min<std::size_t>(descriptor.state_size, kMaxStateBytes));
  effort.clear(joints);
  probes.fill(0.0);
  step = descriptor.step;
}

Result<SandboxMemory> SandboxMemory::make() {
  const std::size_t inside = whole_pages(sizeof(Sandbox)), page = whole_pages(1);
  Mapping pages = Mapping::make(inside + 2 * page, PROT_NONE);
  if (!pages || mprotect(pages.bytes() + page, inside, PROT_READ | PROT_WRITE) != 0)
    return Error{std::string("no memory for the law's own pages: ") + std::strerror(errno)};
  auto* sandbox = new (pages.bytes() + page) Sandbox;  // its constructor touches every page
  return SandboxMemory(std::move(pages), sandbox);
}

}  // namespace lithe::law
