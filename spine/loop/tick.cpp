// SPDX-License-Identifier: Apache-2.0
// The tick, in the order of the timing figure: hand over, step, publish. The step (listen, law, guard, swap) is in
// spine/step/step.cpp.
#include "spine/loop/spine.hpp"
#include "spine/loop/transport.hpp"

namespace lithe::loop {

using wire::EventKind;

void Spine::tick(std::int64_t release_ns, std::int64_t woke_ns, std::uint32_t skipped) LITHE_RT {
  // Durations come from the clock; the time itself is an argument, so that a test can choose it.
  const std::int64_t from_ns = clock_.now_ns();
  out_.record().tick = ++tick_;
  const bool missed = count_release(release_ns, woke_ns, skipped);
  const bool exchanged = exchange();  // u_k leaves, x_k is here
  const std::int64_t handed_ns = clock_.now_ns();

  out_.heartbeat(woke_ns);
  const step::Report& report =
      decide({.tick = tick_, .now_ns = woke_ns, .sample = *sample_, .exchanged = exchanged, .deadline_missed = missed});

  Durations& durations = timing_.durations;
  durations.handoff_ns = inline_actuators_ == nullptr ? handed_ns - from_ns : timing_.served_ns - timing_.last_from_ns;
  timing_.last_from_ns = from_ns;
  publish(report, release_ns, exchanged);
  durations.tick_ns = clock_.now_ns() - from_ns;
  timing_.missed_deadline = durations.release_jitter_ns + durations.tick_ns > grid_.period_ns();
}

// Skipped releases and missed deadlines are counted here and nowhere else.
bool Spine::count_release(std::int64_t release_ns, std::int64_t woke_ns, std::uint32_t skipped) LITHE_RT {
  Durations& durations = timing_.durations;
  durations.release_jitter_ns = woke_ns - release_ns;
  if (skipped == 0 && !timing_.missed_deadline) return false;
  out_.skipped(skipped, durations.release_jitter_ns, grid_.period_ns());
  out_.event(EventKind::deadline_missed, woke_ns, skipped, static_cast<double>(durations.tick_ns),
             skipped > 0 ? "releases were skipped" : "the tick ended after its deadline");
  return true;
}

// Hands u_k over and takes x_k. While the Transport is still busy, this tick sends no command and gets no sample.
bool Spine::exchange() LITHE_RT {
  if (!handover_.idle()) return false;
  sample_ = &handover_.latest_sample();
  timing_.durations.bus_ns = sample_->bus_ns;
  handover_.dispatch();
  return true;
}

// What came in from other processes, the step, and the answer.
const step::Report& Spine::decide(step::Input in) LITHE_RT {
  in.estop_pressed = inbox_.estop_pressed();
  in.damaged = constants_ == nullptr ? nullptr : constants_->damaged();
  in.command = inbox_.next_command();
  in.untried = in.command != nullptr && inbox_.is_from_brain() && inbox_.supervised();
  in.brain_age_ns = inbox_.brain_age_ns(in.now_ns);
  if (inbox_.new_plan()) in.plan = &inbox_.plan();
  in.plan_torn = inbox_.plan_torn();
  in.inputs = inbox_.new_inputs();
  const step::Report& report = step_.run(in, host_, handover_.next_command(), out_.record());  // u_{k+1}
  if (in.command != nullptr) inbox_.answer(report.answer);
  return report;
}

void Spine::publish(const step::Report& report, std::int64_t release_ns, bool exchanged) LITHE_RT {
  timing_.durations.law_ns = report.law_ns;
  timing_.durations.guard_ns = report.guard_ns;
  out_.record().release_ns = release_ns;
  out_.tell(report, step_.laws());
  out_.publish(timing_.durations, exchanged && sample_->sample_ns != 0);
  const law::Resident* law = step_.laws().active();
  if (law != nullptr && tick_ % state_ticks_ == 0) out_.state(*law);
}

void Spine::serve_inline() LITHE_RT {
  if (inline_actuators_ == nullptr || !handover_.pending()) return;
  timing_.served_ns = clock_.now_ns();
  serve_once(handover_, *inline_actuators_, clock_.raw());
}

}  // namespace lithe::loop
