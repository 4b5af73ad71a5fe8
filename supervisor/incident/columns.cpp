// SPDX-License-Identifier: Apache-2.0
#include "supervisor/incident/columns.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <type_traits>

#include "spine/wire/fields.hpp"

namespace lithe::control {
namespace {

static_assert(std::endian::native == std::endian::little);

template <class T>
constexpr char kind_of() {
  return std::is_floating_point_v<T> ? 'f' : std::is_signed_v<T> ? 'i' : 'u';
}

// Calls visit(name, first value, number of values kept) for each field; of joint arrays `joints` are kept.
template <class Visit>
void for_each_kept(wire::Telemetry& record, std::size_t joints, Visit&& visit) {
  wire::for_each_field(record, [&](std::string_view name, auto& field) {
    using Field = std::remove_reference_t<decltype(field)>;
    if constexpr (std::is_arithmetic_v<Field>)
      visit(name, &field, std::size_t{0});
    else
      visit(name, field.data(), field.size() == wire::kNj ? joints : field.size());
  });
}

}  // namespace

void Columns::add(wire::Telemetry& record) {
  for_each_kept(record, joints_, [this](std::string_view, const auto* values, std::size_t count) {
    bytes_.append(reinterpret_cast<const char*>(values), std::max<std::size_t>(count, 1) * sizeof *values);
  });
  ++rows_;
}

std::string Columns::npy() const {
  std::string fields;
  wire::Telemetry any;
  for_each_kept(any, joints_, [&fields](std::string_view name, const auto* values, std::size_t count) {
    using Value = std::remove_cvref_t<decltype(*values)>;
    const std::string shape = count == 0 ? "" : fmt::format(", ({},)", count);
    fields += fmt::format("('{}', '<{}{}'{}), ", name, kind_of<Value>(), sizeof(Value), shape);
  });
  std::string header = fmt::format("{{'descr': [{}], 'fortran_order': False, 'shape': ({},), }}", fields, rows_);
  constexpr std::size_t kBefore = 10, kAligned = 64;  // magic, version and length of the header; numpy's alignment
  header.append((kAligned - (kBefore + header.size() + 1) % kAligned) % kAligned, ' ');
  header += '\n';
  std::string file = std::string("\x93NUMPY\x01\x00", 8);
  file += static_cast<char>(header.size() & 0xff);
  file += static_cast<char>(header.size() >> 8);
  file.reserve(file.size() + header.size() + bytes_.size());
  return file.append(header).append(bytes_);
}

}  // namespace lithe::control
