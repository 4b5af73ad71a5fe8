// SPDX-License-Identifier: Apache-2.0
// Collects the errors of one file, to report all of them at once in the file's order; and what holds after reading it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "spine/core/result.hpp"

namespace lithe::robot {

struct Place {
  std::uint32_t line = 1;
  std::uint32_t column = 1;
};

// The candidate closest to `word` by edit distance; empty when none is close enough.
std::string_view nearest(std::string_view word, const std::vector<std::string_view>& candidates);

// `; did you mean 'x'?` or, with nothing close, `; one of: a, b, c`. Empty without candidates.
std::string suggestion(std::string_view word, const std::vector<std::string_view>& candidates);

// Contract: never in the tick · one file, one Report
class Report {
 public:
  explicit Report(std::string path) : path_(std::move(path)) {}

  void add(Place place, const std::string& what);
  bool empty() const { return mistakes_.empty(); }
  std::size_t count() const { return mistakes_.size(); }
  Error error() const;  // every mistake, one a line

  // A key of the file that was read, with the value that holds now, given or not.
  void holds(std::string_view key, std::string_view value);
  std::string take_values() { return std::move(values_); }

 private:
  struct Mistake {
    Place place;
    std::string what;
  };
  std::string path_;
  std::vector<Mistake> mistakes_;  // in the order of the file
  std::string values_;
};

}  // namespace lithe::robot
