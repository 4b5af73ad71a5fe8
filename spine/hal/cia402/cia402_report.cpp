// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia402/cia402_report.hpp"

#include "spine/hal/canopen/canopen_pdo.hpp"

namespace lithe::hal::cia402 {

using canopen::SdoClient;

void ReportClient::ask(std::int64_t now_ns, SdoClient& sdo) LITHE_RT {
  if (asked_before_ && now_ns < next_ns_) return;
  if (sdo.outcome() == SdoClient::Outcome::busy) return;
  asked_before_ = true;
  next_ns_ = now_ns + kPauseNs;
  for (std::size_t i = 0; i < kQuestions.size(); ++i) {
    question_ = (question_ + 1) % kQuestions.size();
    if (settled_[question_]) continue;
    sdo.read({kQuestions[question_], 0});
    return;
  }
}

bool ReportClient::on_answer(const SdoClient& sdo) LITHE_RT {
  if (sdo.address() != canopen::Address{kQuestions[question_], 0}) return false;
  if (sdo.outcome() == SdoClient::Outcome::failed) {
    const std::uint32_t why = sdo.abort();
    settled_[question_] = why == canopen::abort_code::kNoObject || why == canopen::abort_code::kNoSubindex;
    return true;
  }
  constexpr double kThousandth = 1e-3;  // mA, mV, thousandths of the rated current
  const std::uint32_t value = sdo.value();
  switch (kQuestions[question_]) {
    case object::kRatedCurrent:
      rated_a_ = kThousandth * value;
      settled_[question_] = true;
      return true;
    case object::kCurrent:
      current_share_ = kThousandth * canopen::signed_of(value, 2);
      return true;
    default:
      voltage_v_ = kThousandth * value;
      return true;
  }
}

double ReportClient::current_a() const LITHE_RT {
  return rated_a_ > 0 ? current_share_ * rated_a_ : DriveReport::kNotReported;
}

}  // namespace lithe::hal::cia402
