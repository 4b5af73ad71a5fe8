// SPDX-License-Identifier: Apache-2.0
// Texts and JSON of a swap's refusals and certificate.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "spine/wire/wire.hpp"
#include "supervisor/core/answer.hpp"

namespace lithe::control {

// The first parameter that the compiled law does not have or does not allow. `law`: its descriptor, as lawd gives it.
std::optional<swap::Refusal> wrong_param(const swap::Json& params, const swap::Json& law);

// The value of each parameter of a law, in its own order: as asked for, else as compiled.
swap::Json all_params(const swap::Json& params, const swap::Json& law);

// The parameter values by index, as the Spine takes them.
// Contract: wrong_param() found nothing
void put_params(const swap::Json& params, const swap::Json& law, wire::StageRequest& request);

// The Loader's refusal. `words`: the text of its event, empty when there was none.
swap::Refusal stage_refusal(wire::StageResult result, const std::string& words);

// The part of the compile service's answer that goes into the certificate.
swap::Json facts_of(const swap::Json& compiled);

// Time of the admission gates [ns], from the compile service's answer; 0 for a law from the cache, which was admitted
// earlier.
std::int64_t admission_ns(const swap::Json& compiled);

// The field names in the event. The text may hold only some of them; `count` is the full number.
swap::Json not_carried_json(const wire::Event& event);

swap::Json shadow_json(const wire::ShadowReport& report);

// Summary of a certificate for `lithe status`: law, verdict, and the reason of a bad verdict.
swap::Json summary_of(const swap::Json& certificate);

}  // namespace lithe::control
