// SPDX-License-Identifier: Apache-2.0
// What the steps of a swap say, in the words of a refusal or of a certificate.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "spine/wire/wire.hpp"
#include "supervisor/swap/answer.hpp"

namespace lithe::control {

// The first parameter that the compiled law does not have or does not allow. `law`: its descriptor, as lawd gives it.
std::optional<swap::Refusal> wrong_param(const swap::Json& params, const swap::Json& law);

// The value of each parameter of a law, in its own order: as asked for, else as compiled.
swap::Json all_params(const swap::Json& params, const swap::Json& law);

// In the Spine's words: by index.
// Contract: wrong_param() found nothing
void put_params(const swap::Json& params, const swap::Json& law, wire::StageRequest& request);

// What the Loader says; `words`: those of its event, empty when it brought none.
swap::Refusal stage_refusal(wire::StageResult result, const std::string& words);

// What the certificate keeps of the compile service's answer.
swap::Json facts_of(const swap::Json& compiled);

// What the gates took, of the compile service's answer; 0 for a law that was admitted when it was first compiled.
std::int64_t admission_ns(const swap::Json& compiled);

// The names that the event tells of; of many, not all may be there: `count`.
swap::Json not_carried_json(const wire::Event& event);

swap::Json shadow_json(const wire::ShadowReport& report);

// A certificate in a few words, for lithe status: whose, its verdict, and the reason if it is not a good one.
swap::Json summary_of(const swap::Json& certificate);

}  // namespace lithe::control
