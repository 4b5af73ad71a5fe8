// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia401/cia401_setup.hpp"

#include "spine/hal/canopen/canopen_words.hpp"

namespace lithe::hal::cia401 {

using canopen::SdoClient;
namespace common = canopen::object;

namespace {

constexpr std::uint32_t kByItsProfile = 255;  // transmission type: on a change, and when the event timer ends
constexpr std::uint8_t kEventTimerMs = 5;     // subindex of 1800h

}  // namespace

std::string describe(const NotReadyReason& not_ready) {
  const std::string object =
      "object " + canopen::hex(not_ready.address.index, 4) + "h:" + std::to_string(not_ready.address.subindex);
  switch (not_ready.kind) {
    case NotReadyKind::none:
      break;
    case NotReadyKind::not_booted:
      return "it was reset and does not report back: check power, wires and its id; it is reset again every 5 s";
    case NotReadyKind::no_answer:
      return "it does not answer when " + object + " is set: check its power and its id";
    case NotReadyKind::refused:
      return "it refuses " + object + ": " + std::string(canopen::abort_name(not_ready.value)) +
             "; has it as many inputs as the robot file says?";
    case NotReadyKind::no_module:
      return "its profile is " + std::to_string(not_ready.value & 0xffff) +
             ", not 401: name the right device, or its kind";
    case NotReadyKind::not_operational:
      return "it left its operational state by itself; it is set up again";
    case NotReadyKind::silent:
      return "its heartbeat has ended: check power and wires; it is reset every 5 s";
  }
  return "";
}

Setup::Setup(const ModuleParams& params) : client_(params.id) {
  add(common::kDeviceType, 0, 0, 0);
  add(common::kProducerHeartbeatMs, 0, canopen::milliseconds(params.heartbeat_s), 2);
  if (params.inputs.analog > 0) add(object::kAnalogInterrupt, 0, 1, 1, true);
  for (std::size_t number = 0; number < kPdos; ++number) add_pdo(number, params);
}

void Setup::add(std::uint16_t index, std::uint8_t subindex, std::uint32_t value, std::uint8_t bytes, bool may_lack) {
  steps_[count_++] = {{index, subindex}, value, bytes, may_lack};
}

void Setup::add_pdo(std::size_t number, const ModuleParams& params) {
  const auto communication = static_cast<std::uint16_t>(common::kTpdo1 + number);
  const auto mapping = static_cast<std::uint16_t>(common::kTpdo1Mapping + number);
  const std::uint32_t id = canopen::cob::kNoRemote | pdo_id(number, params.id);
  const canopen::PdoMap map = pdo_map(number, params.inputs);
  const bool used = !map.objects().empty();
  add(communication, 1, canopen::cob::kOff | id, 4, !used);
  if (!used) return;
  add(mapping, 0, 0, 1);
  std::uint8_t entry = 0;
  for (const canopen::Mapped& mapped : map.objects()) add(mapping, ++entry, mapped.entry(), 4);
  add(mapping, 0, entry, 1);
  add(communication, 2, kByItsProfile, 1);
  add(communication, kEventTimerMs, canopen::milliseconds(params.send_every_s), 2);
  add(communication, 1, id, 4);
}

void Setup::begin() LITHE_RT {
  at_ = 0;
  not_ready_ = {};
  client_.forget();
}

bool Setup::next(std::int64_t now_ns, Frame& frame) LITHE_RT {
  if (at_ >= count_) return false;
  const Step& step = steps_[at_];
  if (client_.outcome() == SdoClient::Outcome::idle) {
    if (step.bytes > 0)
      client_.write(step.address, step.value, step.bytes);
    else
      client_.read(step.address);
  }
  return client_.next(now_ns, frame);
}

Setup::Progress Setup::advance() LITHE_RT {
  if (not_ready_.kind != NotReadyKind::none) return Progress::failed;
  if (at_ >= count_) return Progress::done;
  const Step& step = steps_[at_];
  const SdoClient::Outcome outcome = client_.outcome();
  if (outcome == SdoClient::Outcome::idle || outcome == SdoClient::Outcome::busy) return Progress::busy;
  if (outcome == SdoClient::Outcome::failed) {
    const std::uint32_t why = client_.abort();
    const bool nobody = why == canopen::abort_code::kTimedOut;
    const bool lacks = why == canopen::abort_code::kNoObject || why == canopen::abort_code::kNoSubindex;
    if (!lacks || !step.may_lack) {
      not_ready_ = {nobody ? NotReadyKind::no_answer : NotReadyKind::refused, step.address, why};
      return Progress::failed;
    }
  } else if (step.bytes == 0 && (client_.value() & 0xffff) != kDeviceProfile) {
    not_ready_ = {NotReadyKind::no_module, step.address, client_.value()};
    return Progress::failed;
  }
  client_.forget();
  return ++at_ >= count_ ? Progress::done : Progress::busy;
}

}  // namespace lithe::hal::cia401
