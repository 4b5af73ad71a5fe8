// SPDX-License-Identifier: Apache-2.0
// The names, types and offsets of the fields of a plain struct, at compile time and without macros.
// Contract: not for laws to use; lithe/law.hpp turns it into the descriptor the Spine reads.
#pragma once

#include <array>
#include <cstddef>
#include <string_view>
#include <tuple>
#include <type_traits>
#include <utility>

namespace lithe::reflect {

inline constexpr std::size_t kMaxFields = 32;

// Converts to every type: the number of them that initialises T is T's number of fields.
struct Any {
  template <class T>
  operator T() const;  // NOLINT(google-explicit-constructor)
};

template <class T, std::size_t... I>
concept BuiltFromFlat = requires { T{((void)I, Any{})...}; };
template <class T, std::size_t... I>
concept BuiltFromBraced = requires { T{{((void)I, Any{})}...}; };

// Fields counted with brace elision: a C array counts once per element.
template <class T, std::size_t... I>
consteval std::size_t count_flat(std::index_sequence<I...>) {
  if constexpr (sizeof...(I) < kMaxFields + 1 && BuiltFromFlat<T, I..., 0>)
    return count_flat<T>(std::index_sequence<I..., 0>{});
  else
    return sizeof...(I);
}

// Fields counted without brace elision: the number of names a structured binding needs.
template <class T, std::size_t... I>
consteval std::size_t count_braced(std::index_sequence<I...>) {
  if constexpr (sizeof...(I) < kMaxFields + 1 && BuiltFromBraced<T, I..., 0>)
    return count_braced<T>(std::index_sequence<I..., 0>{});
  else
    return sizeof...(I);
}

template <class T>
consteval std::size_t field_count() {
  if constexpr (std::is_empty_v<T>)
    return 0;
  else
    return count_flat<T>(std::index_sequence<>{});
}

template <class T>
consteval bool has_c_array() {
  if constexpr (std::is_empty_v<T>)
    return false;
  else
    return count_flat<T>(std::index_sequence<>{}) != count_braced<T>(std::index_sequence<>{});
}

// A default object of T. The addresses of its fields, as template arguments, carry the field names.
template <class T>
inline constexpr T kDefaults{};

template <class... Field>
constexpr auto addresses_of(const Field&... field) {
  return std::tuple(&field...);
}

// clang-format off
// A structured binding needs a name for each field: one list of names, and one arm of field_addresses, for each count.
#define LITHE_FIELDS_1 f0
#define LITHE_FIELDS_2 LITHE_FIELDS_1, f1
#define LITHE_FIELDS_3 LITHE_FIELDS_2, f2
#define LITHE_FIELDS_4 LITHE_FIELDS_3, f3
#define LITHE_FIELDS_5 LITHE_FIELDS_4, f4
#define LITHE_FIELDS_6 LITHE_FIELDS_5, f5
#define LITHE_FIELDS_7 LITHE_FIELDS_6, f6
#define LITHE_FIELDS_8 LITHE_FIELDS_7, f7
#define LITHE_FIELDS_9 LITHE_FIELDS_8, f8
#define LITHE_FIELDS_10 LITHE_FIELDS_9, f9
#define LITHE_FIELDS_11 LITHE_FIELDS_10, f10
#define LITHE_FIELDS_12 LITHE_FIELDS_11, f11
#define LITHE_FIELDS_13 LITHE_FIELDS_12, f12
#define LITHE_FIELDS_14 LITHE_FIELDS_13, f13
#define LITHE_FIELDS_15 LITHE_FIELDS_14, f14
#define LITHE_FIELDS_16 LITHE_FIELDS_15, f15
#define LITHE_FIELDS_17 LITHE_FIELDS_16, f16
#define LITHE_FIELDS_18 LITHE_FIELDS_17, f17
#define LITHE_FIELDS_19 LITHE_FIELDS_18, f18
#define LITHE_FIELDS_20 LITHE_FIELDS_19, f19
#define LITHE_FIELDS_21 LITHE_FIELDS_20, f20
#define LITHE_FIELDS_22 LITHE_FIELDS_21, f21
#define LITHE_FIELDS_23 LITHE_FIELDS_22, f22
#define LITHE_FIELDS_24 LITHE_FIELDS_23, f23
#define LITHE_FIELDS_25 LITHE_FIELDS_24, f24
#define LITHE_FIELDS_26 LITHE_FIELDS_25, f25
#define LITHE_FIELDS_27 LITHE_FIELDS_26, f26
#define LITHE_FIELDS_28 LITHE_FIELDS_27, f27
#define LITHE_FIELDS_29 LITHE_FIELDS_28, f28
#define LITHE_FIELDS_30 LITHE_FIELDS_29, f29
#define LITHE_FIELDS_31 LITHE_FIELDS_30, f30
#define LITHE_FIELDS_32 LITHE_FIELDS_31, f31
#define LITHE_ARM(count)                         \
  if constexpr (n == (count)) {                  \
    const auto& [LITHE_FIELDS_##count] = object; \
    return addresses_of(LITHE_FIELDS_##count);   \
  } else

// The addresses of all fields of `object`, as a tuple of typed pointers.
template <class T>
constexpr auto field_addresses(const T& object) {
  constexpr std::size_t n = field_count<T>();
  LITHE_ARM(1) LITHE_ARM(2) LITHE_ARM(3) LITHE_ARM(4) LITHE_ARM(5) LITHE_ARM(6) LITHE_ARM(7) LITHE_ARM(8)
  LITHE_ARM(9) LITHE_ARM(10) LITHE_ARM(11) LITHE_ARM(12) LITHE_ARM(13) LITHE_ARM(14) LITHE_ARM(15) LITHE_ARM(16)
  LITHE_ARM(17) LITHE_ARM(18) LITHE_ARM(19) LITHE_ARM(20) LITHE_ARM(21) LITHE_ARM(22) LITHE_ARM(23) LITHE_ARM(24)
  LITHE_ARM(25) LITHE_ARM(26) LITHE_ARM(27) LITHE_ARM(28) LITHE_ARM(29) LITHE_ARM(30) LITHE_ARM(31) LITHE_ARM(32)
  {
    return std::tuple<>();
  }
}
#undef LITHE_ARM
// clang-format on

// The compiler's own text for "address of that field" ends in the name of the field.
template <auto Address>
consteval const char* pretty() {
  return __PRETTY_FUNCTION__;
}

consteval std::string_view last_identifier(std::string_view text) {
  const auto is_word = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_';
  };
  while (!text.empty() && !is_word(text.back())) text.remove_suffix(1);
  std::size_t first = text.size();
  while (first > 0 && is_word(text[first - 1])) --first;
  return text.substr(first);
}

template <class T, std::size_t I>
consteval std::string_view field_name() {
  constexpr auto kAddress = std::get<I>(field_addresses(kDefaults<T>));
  return last_identifier(pretty<kAddress>());
}

template <class T, std::size_t I>
using FieldType = std::remove_cvref_t<decltype(*std::get<I>(field_addresses(std::declval<const T&>())))>;

// Offset of field I. A plain struct puts each field at the next multiple of its alignment.
template <class T, std::size_t I>
consteval std::size_t field_offset() {
  constexpr std::size_t kAlign = alignof(FieldType<T, I>);
  if constexpr (I == 0)
    return 0;
  else
    return (field_offset<T, I - 1>() + sizeof(FieldType<T, I - 1>) + kAlign - 1) / kAlign * kAlign;
}

// True when the layout is the one field_offset computes (false for alignas on a field).
template <class T>
consteval bool has_plain_layout() {
  constexpr std::size_t kN = field_count<T>();
  if constexpr (kN == 0) {
    return true;
  } else {
    constexpr std::size_t kEnd = field_offset<T, kN - 1>() + sizeof(FieldType<T, kN - 1>);
    return (kEnd + alignof(T) - 1) / alignof(T) * alignof(T) == sizeof(T);
  }
}

}  // namespace lithe::reflect
