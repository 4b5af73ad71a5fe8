// SPDX-License-Identifier: Apache-2.0
#include "host/doctor/diagnosis.hpp"

#include <utility>

namespace lithe::host {

Diagnosis diagnose(const HostFiles& files, int cpu, std::optional<Measured> measured) {
  Diagnosis diagnosis;
  diagnosis.subject = read_subject(files, cpu, std::move(measured));
  diagnosis.kernel = kernel_facts(files);
  diagnosis.hypervisor = hypervisor_of(files);
  for (const Item& each : checklist()) diagnosis.findings.push_back(each.check(diagnosis.subject));
  diagnosis.verdict = judge_tier(diagnosis.subject, diagnosis.findings);
  return diagnosis;
}

}  // namespace lithe::host
