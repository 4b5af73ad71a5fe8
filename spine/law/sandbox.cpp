// SPDX-License-Identifier: Apache-2.0
#include "spine/law/sandbox.hpp"

#include <sys/mman.h>
#include <unistd.h>

#include <cerrno>
#include <new>
#include <utility>

namespace lithe::law {
namespace {

void copy(const JointArray& from, JointArray& to, std::uint32_t joints) LITHE_RT {
  std::memcpy(to.data(), from.data(), joints * sizeof(double));
}

}  // namespace

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
  copy(in.position_rad, tick.position_rad, joints);
  copy(in.velocity_rad_s, tick.velocity_rad_s, joints);
  copy(in.torque_nm, tick.torque_nm, joints);
  copy(in.setpoint_position_rad, tick.setpoint_position_rad, joints);
  copy(in.setpoint_velocity_rad_s, tick.setpoint_velocity_rad_s, joints);
  copy(in.setpoint_acceleration_rad_s2, tick.setpoint_acceleration_rad_s2, joints);
  tick.sensor = in.sensor;
  const LitheLaw& descriptor = *law.descriptor;
  std::memcpy(params.data(), law.params.data(),
              std::min<std::size_t>(descriptor.param_count, kMaxParams) * sizeof(Param));
  std::memcpy(state.data(), law.state.data(), std::min<std::size_t>(descriptor.state_size, kMaxStateBytes));
  effort.clear(joints);
  probes.fill(0.0);
  step = descriptor.step;
}

Result<SandboxMemory> SandboxMemory::make() {
  const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  const std::size_t inside = (sizeof(Sandbox) + page - 1) / page * page;
  const std::size_t bytes = inside + 2 * page;
  void* pages = mmap(nullptr, bytes, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (pages == MAP_FAILED) return Error{"no memory for the law's own pages: " + std::string(std::strerror(errno))};
  auto* first = static_cast<std::byte*>(pages) + page;
  if (mprotect(first, inside, PROT_READ | PROT_WRITE) != 0) {
    const int failure = errno;
    munmap(pages, bytes);
    return Error{"no memory for the law's own pages: " + std::string(std::strerror(failure))};
  }
  return SandboxMemory(pages, bytes, new (first) Sandbox);  // its constructor touches every page
}

SandboxMemory::SandboxMemory(SandboxMemory&& other) noexcept
    : pages_(std::exchange(other.pages_, nullptr)), bytes_(other.bytes_), sandbox_(other.sandbox_) {}

SandboxMemory::~SandboxMemory() {
  if (pages_ != nullptr) munmap(pages_, bytes_);
}

}  // namespace lithe::law
