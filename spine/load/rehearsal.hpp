// SPDX-License-Identifier: Apache-2.0
// Rehearsal: the first calls of new code, off the tick and on copies (init, and a few harmless steps).
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>

#include "lithe/law.hpp"
#include "spine/contain/fault_barrier.hpp"
#include "spine/ipc/layout.hpp"
#include "spine/law/resident.hpp"
#include "spine/law/sandbox.hpp"

namespace lithe::load {

// Ticks a law may look back on: two seconds at 1 kHz.
inline constexpr std::uint32_t kMostPast = 2048;

// False for a record of a broken sensor. A law's init() gets finite numbers only.
bool is_finite(const wire::Telemetry& record, std::uint32_t joints);

// Contract: Loader thread only · allocates when made, never after · without a FaultBarrier, a law that crashes here
// ends the process
class Rehearsal {
 public:
  // `joints` and `dt_s` are the robot's; `sandbox` is the Loader's own.
  Rehearsal(const ipc::SpineMemory& spine, std::uint32_t joints, double dt_s, law::Sandbox& sandbox);

  void use(contain::FaultBarrier* barrier) { barrier_ = barrier; }

  // Prepares a new law for its commit: runs its init() on the past, and warms its pages and cache lines. False, with
  // one sentence in `why`, when it fails or an output is not finite.
  bool prepare(law::Resident& law, std::int64_t now_ns, std::span<char> why);

 private:
  bool start(law::Resident& law, std::int64_t now_ns, std::span<char> why);
  bool dry_steps(const law::Resident& law, std::span<char> why);
  bool contained(contain::FaultBarrier::Call call, void* context, const char* what, std::span<char> why);
  const History& look_back(std::int64_t now_ns);

  const ipc::SpineMemory& spine_;
  std::uint32_t joints_;
  double dt_s_;
  law::Sandbox& sandbox_;
  contain::FaultBarrier* barrier_ = nullptr;
  law::Resident scratch_{};  // the dry steps' copy
  std::unique_ptr<std::array<PastTick, kMostPast>> past_;
  History history_;
  wire::Telemetry record_{};
};

}  // namespace lithe::load
