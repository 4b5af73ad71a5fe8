// SPDX-License-Identifier: Apache-2.0
// Units and encoding of register values.
#include <array>
#include <bit>
#include <cmath>
#include <initializer_list>
#include <limits>

#include "spine/hal/moteus/moteus_codec.hpp"

namespace lithe::hal::moteus {
namespace {

// One count of int8, int16, int32, by Quantity.
constexpr double kWorth[][3] = {
    {1, 1, 1},                                   // integer
    {0.01, 0.0001, 0.00001},                     // position
    {0.1, 0.00025, 0.00001},                     // velocity
    {0.05, 0.001, 0.00001},                      // acceleration
    {0.5, 0.01, 0.001},                          // torque
    {1.0 / 127, 1.0 / 32767, 1.0 / 2147483647},  // fraction
    {0.5, 0.1, 0.001},                           // voltage
    {1, 0.1, 0.001},                             // temperature
    {1, 0.1, 0.001},                             // current
    {0.01, 0.001, 0.000001},                     // time
    {10, 0.05, 0.0001},                          // power
};

std::int32_t to_counts(double value, double worth, std::int32_t most) LITHE_RT {
  if (!std::isfinite(value)) return -most - 1;
  const double counts = value / worth;
  if (counts >= most) return most;
  if (counts <= -most) return -most;
  return static_cast<std::int32_t>(counts);
}

void put_little_endian(std::uint32_t bits, std::size_t bytes, std::uint8_t* out) LITHE_RT {
  for (std::size_t i = 0; i < bytes; ++i) out[i] = static_cast<std::uint8_t>(bits >> (8 * i));
}

std::uint32_t get_little_endian(const std::uint8_t* in, std::size_t bytes) LITHE_RT {
  std::uint32_t bits = 0;
  for (std::size_t i = 0; i < bytes; ++i) bits |= std::uint32_t{in[i]} << (8 * i);
  return bits;
}

constexpr std::size_t kLow = 0x080;  // from here on only integers, with two exceptions

constexpr std::array<Quantity, kLow> table() {
  using enum Quantity;
  std::array<Quantity, kLow> of{};  // integer by default
  const auto row = [&of](std::uint32_t first, std::initializer_list<Quantity> quantities) {
    for (const Quantity quantity : quantities) of[first++] = quantity;
  };
  row(reg::kPosition, {position_rev, velocity_rev_s, torque_nm, current_a, current_a, position_rev, power_w});
  row(reg::kMotorTemperature, {temperature_c});
  row(reg::kVoltage, {voltage_v, temperature_c});
  row(reg::kCommandQCurrent, {current_a, current_a});
  row(reg::kCommandPosition, {position_rev, velocity_rev_s, torque_nm, fraction, fraction, torque_nm, position_rev,
                              time_s, velocity_rev_s, acceleration_rev_s2, voltage_v, fraction, current_a});
  row(reg::kTermP, {torque_nm, torque_nm, torque_nm, torque_nm, torque_nm});
  row(reg::kControlPosition, {position_rev, velocity_rev_s, torque_nm, position_rev, velocity_rev_s, torque_nm});
  row(reg::kLowerBound, {position_rev, position_rev, torque_nm, fraction, fraction, torque_nm, time_s, fraction});
  row(reg::kEncoder, {position_rev, velocity_rev_s, position_rev, velocity_rev_s, position_rev, velocity_rev_s});
  for (const std::uint32_t port : {reg::kAux1Analog, reg::kAux2Analog, reg::kAuxPwm, reg::kAuxPwm + 5}) {
    row(port, {fraction, fraction, fraction, fraction, fraction});
  }
  of[reg::kPwmInput + 1] = of[reg::kPwmInput + 3] = fraction;
  return of;
}

constexpr std::array<Quantity, kLow> kTable = table();

}  // namespace

Quantity quantity_of(std::uint32_t number) LITHE_RT {
  if (number < kLow) return kTable[number];
  const bool output = number == reg::kSetOutputNearest || number == reg::kSetOutputExact;
  return output ? Quantity::position_rev : Quantity::integer;
}

double count_worth(Quantity quantity, Format format) LITHE_RT {
  if (format == Format::float32) return 1;
  return kWorth[static_cast<std::size_t>(quantity)][static_cast<std::size_t>(format)];
}

double largest(Quantity quantity, Format format) LITHE_RT {
  constexpr double kCounts[] = {127, 32767, 2147483647, std::numeric_limits<double>::infinity()};
  return kCounts[static_cast<std::size_t>(format)] * count_worth(quantity, format);
}

void encode_value(double value, Quantity quantity, Format format, std::uint8_t* out) LITHE_RT {
  const double worth = count_worth(quantity, format);
  std::uint32_t bits = 0;
  switch (format) {
    case Format::int8:
      bits = static_cast<std::uint32_t>(to_counts(value, worth, std::numeric_limits<std::int8_t>::max()));
      break;
    case Format::int16:
      bits = static_cast<std::uint32_t>(to_counts(value, worth, std::numeric_limits<std::int16_t>::max()));
      break;
    case Format::int32:
      bits = static_cast<std::uint32_t>(to_counts(value, worth, std::numeric_limits<std::int32_t>::max()));
      break;
    case Format::float32:
      bits = std::bit_cast<std::uint32_t>(static_cast<float>(value));
      break;
  }
  put_little_endian(bits, bytes_of(format), out);
}

double decode_value(const std::uint8_t* in, Quantity quantity, Format format) LITHE_RT {
  const std::uint32_t bits = get_little_endian(in, bytes_of(format));
  if (format == Format::float32) return std::bit_cast<float>(bits);
  const unsigned unused_bits = 32 - 8 * static_cast<unsigned>(bytes_of(format));
  const std::int32_t counts = static_cast<std::int32_t>(bits << unused_bits) >> unused_bits;
  const std::int32_t smallest = std::numeric_limits<std::int32_t>::min() >> unused_bits;
  if (counts == smallest) return std::numeric_limits<double>::quiet_NaN();
  return counts * count_worth(quantity, format);
}

}  // namespace lithe::hal::moteus
