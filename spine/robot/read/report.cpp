// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/read/report.hpp"

#include <algorithm>
#include <tuple>

#include "spine/core/text.hpp"

namespace lithe::robot {
namespace {

constexpr std::size_t kMostShown = 20;

}  // namespace

std::string_view nearest(std::string_view word, const std::vector<std::string_view>& candidates) {
  if (word.size() > 64) return {};
  std::string_view best;
  // Of a word of three letters two may not differ: `foo` is no `top`.
  std::size_t best_distance = (word.size() <= 3 ? 1 : std::max<std::size_t>(2, word.size() / 3)) + 1;
  for (const std::string_view candidate : candidates) {
    // A shortened or lengthened word (`position_max` for `position_max_rad`) counts as closer than its edit distance.
    const bool prefix = word.size() >= 3 && (candidate.starts_with(word) || word.starts_with(candidate));
    const std::size_t d = prefix ? 1 : edit_distance(word, candidate);
    if (d < best_distance) {
      best_distance = d;
      best = candidate;
    }
  }
  return best;
}

std::string suggestion(std::string_view word, const std::vector<std::string_view>& candidates) {
  if (candidates.empty()) return {};
  if (const std::string_view best = nearest(word, candidates); !best.empty())
    return "; did you mean '" + std::string(best) + "'?";
  std::string text = "; one of: ";
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    if (i > 0) text += ", ";
    text += candidates[i];
  }
  return text;
}

void Report::add(Place place, const std::string& what) {
  const auto later = std::find_if(mistakes_.begin(), mistakes_.end(), [&](const Mistake& other) {
    return std::tie(place.line, place.column) < std::tie(other.place.line, other.place.column);
  });
  mistakes_.insert(later, {place, printable(what)});  // it contains text of the file
}

void Report::holds(std::string_view key, std::string_view value) {
  values_.append(key).append(" = ").append(value).append("\n");
}

Error Report::error() const {
  std::string text;
  for (std::size_t i = 0; i < std::min(mistakes_.size(), kMostShown); ++i) {
    if (i > 0) text += '\n';
    text += path_ + ':' + std::to_string(mistakes_[i].place.line) + ':' + std::to_string(mistakes_[i].place.column) +
            ": " + mistakes_[i].what;
  }
  if (mistakes_.size() > kMostShown)
    text += "\n(and " + std::to_string(mistakes_.size() - kMostShown) + " more; correct these first)";
  return Error{text};
}

}  // namespace lithe::robot
