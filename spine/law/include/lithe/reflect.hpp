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
  if constexpr (sizeof...(I) < kMaxFields + 1 && BuiltFromFlat<T, I..., 0>) {
    return count_flat<T>(std::index_sequence<I..., 0>{});
  } else {
    return sizeof...(I);
  }
}

// Fields counted without brace elision: the number of names a structured binding needs.
template <class T, std::size_t... I>
consteval std::size_t count_braced(std::index_sequence<I...>) {
  if constexpr (sizeof...(I) < kMaxFields + 1 && BuiltFromBraced<T, I..., 0>) {
    return count_braced<T>(std::index_sequence<I..., 0>{});
  } else {
    return sizeof...(I);
  }
}

template <class T>
consteval std::size_t field_count() {
  if constexpr (std::is_empty_v<T>) {
    return 0;
  } else {
    return count_flat<T>(std::index_sequence<>{});
  }
}

template <class T>
consteval bool has_c_array() {
  if constexpr (std::is_empty_v<T>) {
    return false;
  } else {
    return count_flat<T>(std::index_sequence<>{}) != count_braced<T>(std::index_sequence<>{});
  }
}

// A default object of T. The addresses of its fields, as template arguments, carry the field names.
template <class T>
inline constexpr T kDefaults{};

// The addresses of all fields of `object`, as a tuple of typed pointers.
template <class T>
constexpr auto field_addresses(const T& object) {
  constexpr std::size_t n = field_count<T>();
  if constexpr (n == 1) {
    const auto& [f0] = object;
    return std::tuple(&f0);
  } else if constexpr (n == 2) {
    const auto& [f0, f1] = object;
    return std::tuple(&f0, &f1);
  } else if constexpr (n == 3) {
    const auto& [f0, f1, f2] = object;
    return std::tuple(&f0, &f1, &f2);
  } else if constexpr (n == 4) {
    const auto& [f0, f1, f2, f3] = object;
    return std::tuple(&f0, &f1, &f2, &f3);
  } else if constexpr (n == 5) {
    const auto& [f0, f1, f2, f3, f4] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4);
  } else if constexpr (n == 6) {
    const auto& [f0, f1, f2, f3, f4, f5] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5);
  } else if constexpr (n == 7) {
    const auto& [f0, f1, f2, f3, f4, f5, f6] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6);
  } else if constexpr (n == 8) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7);
  } else if constexpr (n == 9) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8);
  } else if constexpr (n == 10) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9);
  } else if constexpr (n == 11) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10);
  } else if constexpr (n == 12) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11);
  } else if constexpr (n == 13) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12);
  } else if constexpr (n == 14) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13);
  } else if constexpr (n == 15) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14);
  } else if constexpr (n == 16) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15);
  } else if constexpr (n == 17) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15, &f16);
  } else if constexpr (n == 18) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16, f17] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15, &f16, &f17);
  } else if constexpr (n == 19) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16, f17, f18] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15, &f16, &f17,
                      &f18);
  } else if constexpr (n == 20) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16, f17, f18, f19] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15, &f16, &f17,
                      &f18, &f19);
  } else if constexpr (n == 21) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16, f17, f18, f19, f20] =
        object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15, &f16, &f17,
                      &f18, &f19, &f20);
  } else if constexpr (n == 22) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16, f17, f18, f19, f20, f21] =
        object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15, &f16, &f17,
                      &f18, &f19, &f20, &f21);
  } else if constexpr (n == 23) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16, f17, f18, f19, f20, f21,
                 f22] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15, &f16, &f17,
                      &f18, &f19, &f20, &f21, &f22);
  } else if constexpr (n == 24) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16, f17, f18, f19, f20, f21,
                 f22, f23] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15, &f16, &f17,
                      &f18, &f19, &f20, &f21, &f22, &f23);
  } else if constexpr (n == 25) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16, f17, f18, f19, f20, f21,
                 f22, f23, f24] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15, &f16, &f17,
                      &f18, &f19, &f20, &f21, &f22, &f23, &f24);
  } else if constexpr (n == 26) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16, f17, f18, f19, f20, f21,
                 f22, f23, f24, f25] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15, &f16, &f17,
                      &f18, &f19, &f20, &f21, &f22, &f23, &f24, &f25);
  } else if constexpr (n == 27) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16, f17, f18, f19, f20, f21,
                 f22, f23, f24, f25, f26] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15, &f16, &f17,
                      &f18, &f19, &f20, &f21, &f22, &f23, &f24, &f25, &f26);
  } else if constexpr (n == 28) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16, f17, f18, f19, f20, f21,
                 f22, f23, f24, f25, f26, f27] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15, &f16, &f17,
                      &f18, &f19, &f20, &f21, &f22, &f23, &f24, &f25, &f26, &f27);
  } else if constexpr (n == 29) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16, f17, f18, f19, f20, f21,
                 f22, f23, f24, f25, f26, f27, f28] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15, &f16, &f17,
                      &f18, &f19, &f20, &f21, &f22, &f23, &f24, &f25, &f26, &f27, &f28);
  } else if constexpr (n == 30) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16, f17, f18, f19, f20, f21,
                 f22, f23, f24, f25, f26, f27, f28, f29] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15, &f16, &f17,
                      &f18, &f19, &f20, &f21, &f22, &f23, &f24, &f25, &f26, &f27, &f28, &f29);
  } else if constexpr (n == 31) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16, f17, f18, f19, f20, f21,
                 f22, f23, f24, f25, f26, f27, f28, f29, f30] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15, &f16, &f17,
                      &f18, &f19, &f20, &f21, &f22, &f23, &f24, &f25, &f26, &f27, &f28, &f29, &f30);
  } else if constexpr (n == 32) {
    const auto& [f0, f1, f2, f3, f4, f5, f6, f7, f8, f9, f10, f11, f12, f13, f14, f15, f16, f17, f18, f19, f20, f21,
                 f22, f23, f24, f25, f26, f27, f28, f29, f30, f31] = object;
    return std::tuple(&f0, &f1, &f2, &f3, &f4, &f5, &f6, &f7, &f8, &f9, &f10, &f11, &f12, &f13, &f14, &f15, &f16, &f17,
                      &f18, &f19, &f20, &f21, &f22, &f23, &f24, &f25, &f26, &f27, &f28, &f29, &f30, &f31);
  } else {
    return std::tuple<>();
  }
}

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
  constexpr auto address = std::get<I>(field_addresses(kDefaults<T>));
  return last_identifier(pretty<address>());
}

template <class T, std::size_t I>
using FieldType = std::remove_cvref_t<decltype(*std::get<I>(field_addresses(std::declval<const T&>())))>;

// Offset of field I. A plain struct puts each field at the next multiple of its alignment.
template <class T, std::size_t I>
consteval std::size_t field_offset() {
  constexpr std::size_t align = alignof(FieldType<T, I>);
  if constexpr (I == 0) {
    return 0;
  } else {
    return (field_offset<T, I - 1>() + sizeof(FieldType<T, I - 1>) + align - 1) / align * align;
  }
}

// True when the layout is the one field_offset computes (false for alignas on a field).
template <class T>
consteval bool has_plain_layout() {
  constexpr std::size_t n = field_count<T>();
  if constexpr (n == 0) {
    return true;
  } else {
    constexpr std::size_t end = field_offset<T, n - 1>() + sizeof(FieldType<T, n - 1>);
    return (end + alignof(T) - 1) / alignof(T) * alignof(T) == sizeof(T);
  }
}

}  // namespace lithe::reflect
