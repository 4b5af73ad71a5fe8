// SPDX-License-Identifier: Apache-2.0
// The report of a trial: written by the child as plain bytes; the parent does not trust them.
#pragma once

#include <array>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>

#include "lithe/law.hpp"
#include "spine/core/joints.hpp"
#include "spine/law/diagnosis.hpp"

namespace lithe::trial {

enum class Section : std::uint32_t { load = 0, benign, loop, replay, hostile, timing };
inline constexpr std::size_t kSections = 6;

struct Progress {
  std::uint32_t done = 0;  // its mandatory part, at least
  std::uint32_t steps = 0;
  double ms = 0;
};

// A signal that ended the law, as its handler saw it.
struct Crash {
  std::int32_t signal = 0;  // 0 = none
  std::int32_t system_call = -1;
  std::uint64_t pc = 0, address = 0;
};

// A tick in which the guard took torque from a joint, and what it was like then.
struct Held {
  std::uint32_t tick = 0;
  double wanted_nm = 0, given_nm = 0, position_rad = 0, velocity_rad_s = 0;
};

// Number of ticks in which the guard changed the law's output.
struct LoopStats {
  std::uint32_t whole_ticks = 0;  // of a run that nothing cuts short
  std::uint32_t ticks = 0, torque_clamped = 0, slew_clamped = 0, position_clamped = 0, velocity_clamped = 0;
  std::uint32_t fault = 0;  // wire::Fault, 0 = none
  std::uint32_t fault_tick = 0;
  std::uint32_t fault_joint = 0;
  std::uint32_t held_joint = 0;  // whose torque the guard had to change most often
  Held held;                     // of that joint, where it changed most
  double most_torque_nm = 0;     // asked for
  double most_velocity_rad_s = 0;
  double rms_error_rad = 0;
  std::array<double, kMaxJoints> joint_rms_error_rad{};
  std::uint32_t tremor = 0;  // law::Tremor::Finding::Kind: what it was ended for; 0 = no joint shook
  std::uint32_t tremor_joint = 0;
  double tremor_hz = 0, tremor_size = 0;  // [N m] of chatter, [rad/s] of an oscillation
  double most_chatter_hz = 0;             // how near any joint came to that
  std::uint32_t most_swings = 0;
  double fault_position_rad = 0, fault_velocity_rad_s = 0;  // of that joint, then
};

// Contract: plain bytes · any bytes are safe to read
struct Report {
  static constexpr std::uint64_t kMagic = 0x31545249'5254494c;
  std::uint64_t magic = kMagic;
  std::uint32_t ended = 0;    // 1: the child came to its end, whatever the verdict
  std::uint32_t section = 0;  // where it was, or ended
  std::array<Progress, kSections> progress{};
  std::uint32_t unable = 0;  // 1: the sandbox does not work here; `refused` says why, and nothing is known of the law
  std::array<char, 400> refused{};  // why; empty = nothing against it
  std::array<char, 96> doing{};     // what was being tried, for the words of a crash
  Crash crash;
  std::uint64_t invalid_pc = 0;  // of the first invalid operation of a step that was not finite; 0 = unknown
  std::uint64_t image_base = 0;  // where the law lies: its slot's start, or where dlopen put it

  LoopStats loop, rough, carried;
  std::uint32_t carried_fields = 0;               // of the running law's State; 0: there was no run with it
  std::array<law::JointSums, kMaxJoints> sums{};  // of the first run, or of a later one in which it was refused
  std::array<double, kMaxParams> param_values{};
  std::uint32_t params = 0;
  std::uint32_t hostile_cases = 0, hostile_not_finite = 0, hostile_not_recovered = 0;
  double hostile_worst_ns = 0;
  std::array<char, 96> hostile_slowest{};
  std::uint32_t replay_records = 0, replay_joint = 0;
  double replay_most_torque_nm = 0;
  double takeover_step_nm = 0;       // |new law - what the drives have now|, from a fresh state, the largest joint
  double takeover_warm_step_nm = 0;  // the same after it has seen the recording
  std::uint32_t timing_inputs = 0;
  double first_ns = 0, p50_ns = 0, p999_ns = 0;  // the quantiles: of each input's best of three
  double worst_best_of_3_ns = 0;                 // likewise
  double worst_ns = 0;                           // the longest of all steps that were measured
  std::uint32_t same_bits = 0;
  double reset_difference_nm = 0;  // between a state that has run 100 steps and a fresh one, same input
};

// `alone`, `alone_rough`: the same runs without a law.
nlohmann::json to_json(const Report& report, const LoopStats& alone, const LoopStats& alone_rough, std::uint32_t joints,
                       std::int64_t budget_ns);

const char* name_of(Section section);

// The text in a char array that may lack its zero.
template <std::size_t N>
std::string text_of(const std::array<char, N>& text) {
  std::string out;
  for (std::size_t i = 0; i < N && text[i] != '\0'; ++i) out += text[i];
  return out;
}

}  // namespace lithe::trial
