// SPDX-License-Identifier: Apache-2.0
// Error return of functions outside the tick. Nothing in spine/ throws.
#pragma once

#include <string>
#include <utility>
#include <variant>

namespace lithe {

// An error message for the user: what is wrong, where, and the next step.
struct Error {
  std::string message;
};

struct Done {};

// Either a value or an Error.
// Contract: never in the tick (the message is a heap string).
template <class T = Done>
class [[nodiscard]] Result {
 public:
  Result(T value) : value_(std::in_place_index<0>, std::move(value)) {}      // NOLINT(google-explicit-constructor)
  Result(Error error) : value_(std::in_place_index<1>, std::move(error)) {}  // NOLINT(google-explicit-constructor)

  explicit operator bool() const { return value_.index() == 0; }
  T& operator*() { return *std::get_if<0>(&value_); }
  const T& operator*() const { return *std::get_if<0>(&value_); }
  T* operator->() { return std::get_if<0>(&value_); }
  const T* operator->() const { return std::get_if<0>(&value_); }
  const Error& error() const { return *std::get_if<1>(&value_); }
  const std::string& message() const { return error().message; }

 private:
  std::variant<T, Error> value_;
};

inline Result<> done() { return Done{}; }

}  // namespace lithe
