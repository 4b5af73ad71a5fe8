// SPDX-License-Identifier: Apache-2.0
#include "host/doctor/diagnosis.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <optional>
#include <utility>

#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

using nlohmann::json;

constexpr std::size_t kEvidenceShown = 5;

const char* meaning(Tier tier) {
  switch (tier) {
    case Tier::a:
      return "is isolated since the boot: no other task, no device and no timer tick comes to it";
    case Tier::b:
      return "is isolated: no other task and no device comes to it, the timer tick may";
    case Tier::c:
      return "is kept free by the affinity of other tasks only: a new task may come to it";
    case Tier::d:
      break;
  }
  return "is not protected: other tasks may take it at any time";
}

std::string label(const Diagnosis& diagnosis) {
  const std::optional<bool>& present = diagnosis.hypervisor.present;
  return fmt::format("{}{}", letter(diagnosis.verdict.tier), !present ? "-v?" : *present ? "-v" : "");
}

std::string head(const Diagnosis& diagnosis) {
  std::string text =
      fmt::format("tier {}: core {} {}\n", label(diagnosis), diagnosis.subject.cpu, meaning(diagnosis.verdict.tier));
  text += fmt::format("  kernel {}\n", diagnosis.kernel.words());
  if (diagnosis.hypervisor.present.value_or(true)) {
    text += fmt::format("  {} hypervisor: what it takes away no file here tells, so times are relative only\n",
                        diagnosis.hypervisor.present ? "v: below a" : "v?: perhaps below a");
  }
  if (diagnosis.verdict.missing.empty()) return text;
  const auto name = [](const Missing& each) {
    return each.number == 0 ? each.id : fmt::format("{} ({})", each.id, each.number);
  };
  return text + fmt::format("  missing for tier {}: {}\n", letter(diagnosis.verdict.missing.front().tier),
                            joined(diagnosis.verdict.missing, name));
}

std::string one_item(const Item& item, const Finding& finding, const Subject& subject, bool all) {
  std::string text = fmt::format("  {:>2} {}: {}\n", item.number, item.id, finding.words);
  const std::size_t shown = all ? finding.evidence.size() : std::min(finding.evidence.size(), kEvidenceShown);
  for (std::size_t i = 0; i < shown; ++i) {
    const Evidence& each = finding.evidence[i];
    text += fmt::format("       {} = {}\n", each.path, each.value.empty() ? "(empty)" : each.value);
  }
  if (shown < finding.evidence.size())
    text += fmt::format("       and {} more: --all\n", finding.evidence.size() - shown);
  if (finding.state == State::warn || finding.state == State::fail) {
    text += fmt::format("     why: {}\n     mend{}: {}\n", for_core(item.why, subject),
                        item.reboot ? ", in force after a reboot" : "", for_core(item.fix, subject));
  }
  return text;
}

std::string per_second(const std::optional<double>& rate) { return rate ? fmt::format("{:.1f}/s", *rate) : "unknown"; }

std::string measured_text(const Measured& seen) {
  std::string text = fmt::format(
      "measured on core {} for {:.1f} s\n"
      "  gaps above 1 us: {:.0f}/s, {:.3f} % of the time, longest {:.0f} us\n"
      "  timer ticks {}, device interrupts {}, from other cores {}\n"
      "  switches {:.1f}/s, minor faults {:.1f}/s, taken without a switch {:.3f} % of the time, stolen {}\n"
      "  quietest release phase: {:.0f} us after each millisecond\n",
      seen.cpu, seen.seconds, seen.gaps_per_s, 100 * seen.gap_share, seen.gap_max_us, per_second(seen.ticks_per_s),
      per_second(seen.device_interrupts_per_s), per_second(seen.core_interrupts_per_s), seen.switches_per_s,
      seen.minor_faults_per_s, 100 * seen.stolen_share,
      seen.stolen_s ? fmt::format("{:.2f} s", *seen.stolen_s) : "unknown", seen.quietest_phase_us);
  for (const RateShare& each : seen.rates) {
    text += fmt::format("  {:>5} Hz: {:.4f} % of periods lost more than {:.0f} % to gaps{}\n", each.rate_hz,
                        100 * each.lost_share, 100 * kGapShareOfPeriod, each.holds ? "" : ": too much");
  }
  return text;
}

json optional_json(const auto& value) { return value ? json(*value) : json(nullptr); }

json measured_json(const Measured& seen) {
  json rates = json::array();
  for (const RateShare& each : seen.rates)
    rates.push_back({{"rate_hz", each.rate_hz}, {"lost_share", each.lost_share}, {"holds", each.holds}});
  return {{"cpu", seen.cpu},
          {"seconds", seen.seconds},
          {"gaps_per_s", seen.gaps_per_s},
          {"gap_share", seen.gap_share},
          {"gap_max_us", seen.gap_max_us},
          {"ticks_per_s", optional_json(seen.ticks_per_s)},
          {"device_interrupts_per_s", optional_json(seen.device_interrupts_per_s)},
          {"core_interrupts_per_s", optional_json(seen.core_interrupts_per_s)},
          {"switches_per_s", seen.switches_per_s},
          {"minor_faults_per_s", seen.minor_faults_per_s},
          {"stolen_share", seen.stolen_share},
          {"stolen_s", optional_json(seen.stolen_s)},
          {"quietest_phase_us", seen.quietest_phase_us},
          {"phase_share", seen.phase_share},
          {"rates", rates}};
}

json item_json(const Item& item, const Finding& finding, const Subject& subject) {
  json evidence = json::array();
  for (const Evidence& each : finding.evidence) evidence.push_back({{"path", each.path}, {"value", each.value}});
  return {{"number", item.number},
          {"id", item.id},
          {"title", item.title},
          {"state", word(finding.state)},
          {"words", finding.words},
          {"evidence", evidence},
          {"why", for_core(item.why, subject)},
          {"fix", for_core(item.fix, subject)},
          {"reboot", item.reboot}};
}

}  // namespace

Diagnosis diagnose(const HostFiles& files, int cpu, std::optional<Measured> measured) {
  Diagnosis diagnosis;
  diagnosis.subject = read_subject(files, cpu, std::move(measured));
  diagnosis.kernel = kernel_facts(files);
  diagnosis.hypervisor = hypervisor_of(files);
  for (const Item& each : checklist()) diagnosis.findings.push_back(each.check(diagnosis.subject));
  diagnosis.verdict = judge_tier(diagnosis.subject, diagnosis.findings);
  return diagnosis;
}

std::string to_text(const Diagnosis& diagnosis, bool all) {
  std::string text = head(diagnosis);
  std::size_t ok = 0, none = 0;
  for (const State state : {State::fail, State::warn, State::unknown, State::ok, State::not_applicable}) {
    std::string part;
    std::size_t count = 0;
    for (std::size_t i = 0; i < diagnosis.findings.size(); ++i) {
      if (diagnosis.findings[i].state != state) continue;
      ++count;
      part += one_item(checklist()[i], diagnosis.findings[i], diagnosis.subject, all);
    }
    if (state == State::ok) ok = count;
    if (state == State::not_applicable) none = count;
    const bool shown = all || (state != State::ok && state != State::not_applicable);
    if (shown && count > 0)
      text += fmt::format("\n{}: {}\n{}", state == State::not_applicable ? "not applicable" : word(state), count, part);
  }
  if (diagnosis.subject.measured) text += "\n" + measured_text(*diagnosis.subject.measured);
  return text + fmt::format("\n{} ok, {} not applicable{}\n", ok, none, all ? "" : ": lithe doctor --all lists them");
}

json to_json(const Diagnosis& diagnosis) {
  json items = json::array(), missing = json::array(), virtual_evidence = json::array();
  for (std::size_t i = 0; i < diagnosis.findings.size(); ++i)
    items.push_back(item_json(checklist()[i], diagnosis.findings[i], diagnosis.subject));
  for (const Missing& each : diagnosis.verdict.missing) {
    missing.push_back({{"tier", std::string(1, letter(each.tier))},
                       {"number", each.number == 0 ? json(nullptr) : json(each.number)},
                       {"id", each.id},
                       {"words", each.words}});
  }
  for (const auto& [path, value] : diagnosis.hypervisor.evidence)
    virtual_evidence.push_back({{"path", path}, {"value", value}});
  const Subject& subject = diagnosis.subject;
  return {{"tier", std::string(1, letter(diagnosis.verdict.tier))},
          {"label", label(diagnosis)},
          {"kernel",
           {{"release", diagnosis.kernel.release},
            {"preempt_rt", optional_json(diagnosis.kernel.is_realtime)},
            {"words", diagnosis.kernel.words()}}},
          {"virtual", optional_json(diagnosis.hypervisor.present)},
          {"virtual_evidence", virtual_evidence},
          {"cpu", subject.cpu},
          {"items", items},
          {"missing", missing},
          {"measured", subject.measured ? measured_json(*subject.measured) : json(nullptr)}};
}

namespace {

struct Gate {
  Tier tier;
  const char* id;
};

constexpr Gate kGates[] = {
    {Tier::c, "user_tasks"},    {Tier::c, "spine_pinned"}, {Tier::c, "rt_throttling"},    {Tier::c, "fair_server"},
    {Tier::b, "irq_affinity"},  {Tier::b, "memory_lock"},  {Tier::b, "domain_isolation"}, {Tier::a, "tickless"},
    {Tier::a, "rcu_callbacks"}, {Tier::a, "governor"},
};
constexpr double kFewSwitchesPerS = 2;

bool passes(State state) { return state == State::ok || state == State::not_applicable; }

void ask_items(Tier tier, std::span<const Finding> findings, std::vector<Missing>& missing) {
  const std::span<const Item> items = checklist();
  for (const Gate& gate : kGates) {
    if (gate.tier != tier) continue;
    const auto item = std::ranges::find_if(items, [&](const Item& each) { return each.id == std::string(gate.id); });
    const Finding& finding = findings[static_cast<std::size_t>(item - items.begin())];
    if (!passes(finding.state)) missing.push_back({tier, item->number, gate.id, finding.words});
  }
}

void ask_measurement(Tier tier, const Subject& subject, std::vector<Missing>& missing) {
  if (!subject.measured) return;
  const double switches = subject.measured->switches_per_s;
  if ((tier == Tier::b && switches > kFewSwitchesPerS) || (tier == Tier::a && switches > 0)) {
    missing.push_back(
        {tier, 0, "measured_switches", fmt::format("other tasks took the core {:.1f} times a second", switches)});
  }
  const std::optional<double> stolen_s = subject.measured->stolen_s;
  if (tier == Tier::a && stolen_s != 0.0) {
    missing.push_back(
        {tier, 0, "measured_steal",
         stolen_s ? fmt::format("the hypervisor took {:.2f} s", *stolen_s) : "stolen time cannot be read"});
  }
}

std::vector<Missing> missing_for(Tier tier, const Subject& subject, std::span<const Finding> findings) {
  std::vector<Missing> missing;
  ask_items(tier, findings, missing);
  if (tier == Tier::a && subject.isolated.how(subject.cpu) != Isolation::boot)
    missing.push_back({tier, 1, "boot_isolation", "the core is not isolated since the boot"});
  ask_measurement(tier, subject, missing);
  return missing;
}

}  // namespace

char letter(Tier tier) { return "ABCD"[static_cast<std::size_t>(tier)]; }

TierVerdict judge_tier(const Subject& subject, std::span<const Finding> findings) {
  TierVerdict verdict;
  for (const Tier next : {Tier::c, Tier::b, Tier::a}) {
    verdict.missing = missing_for(next, subject, findings);
    if (!verdict.missing.empty()) return verdict;
    verdict.tier = next;
  }
  return verdict;
}

}  // namespace lithe::host
