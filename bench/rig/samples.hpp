// SPDX-License-Identifier: Apache-2.0
// Measured durations, their quantiles, and the JSON line that a bench program prints.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <string>
#include <vector>

namespace lithe::bench {

// The value below which the fraction `q` of the samples lies. Sorts a copy, so do not call it while measuring.
inline std::int64_t quantile_ns(std::vector<std::int64_t> samples_ns, double q) {
  if (samples_ns.empty()) return 0;
  const auto rank = static_cast<std::size_t>(std::ceil(q * static_cast<double>(samples_ns.size())));
  const std::size_t at = std::clamp<std::size_t>(rank, 1, samples_ns.size()) - 1;
  std::nth_element(samples_ns.begin(), samples_ns.begin() + static_cast<std::ptrdiff_t>(at), samples_ns.end());
  return samples_ns[at];
}

// The share of the samples above a limit.
inline double share_above(const std::vector<std::int64_t>& samples_ns, std::int64_t limit_ns) {
  const auto above =
      std::count_if(samples_ns.begin(), samples_ns.end(), [&](std::int64_t ns) { return ns > limit_ns; });
  return samples_ns.empty() ? 0 : static_cast<double>(above) / static_cast<double>(samples_ns.size());
}

// Rounds in which two subjects took turns: the time of one relative to that of the other in each round, per mille.
inline std::vector<std::int64_t> ratios_pm(const std::vector<std::int64_t>& over_ns,
                                           const std::vector<std::int64_t>& under_ns) {
  std::vector<std::int64_t> ratios;
  for (std::size_t round = 0; round < over_ns.size(); ++round)
    ratios.push_back(1000 * over_ns[round] / std::max<std::int64_t>(under_ns[round], 1));
  return ratios;
}

// The middle one of these ratios.
inline double middle_ratio(const std::vector<std::int64_t>& over_ns, const std::vector<std::int64_t>& under_ns) {
  return static_cast<double>(quantile_ns(ratios_pm(over_ns, under_ns), 0.5)) / 1e3;
}

// One flat JSON object, written member by member.
class JsonLine {
 public:
  JsonLine& number(const std::string& key, double value) {
    char text[64];
    std::snprintf(text, sizeof text, "%.6g", value);
    return add(key, std::isfinite(value) ? text : "null");
  }
  JsonLine& word(const std::string& key, const std::string& value) {
    std::string text;
    for (const char each : value) text += each == '"' || each == '\\' ? std::string("\\") + each : std::string(1, each);
    return add(key, '"' + text + '"');
  }
  JsonLine& flag(const std::string& key, bool value) { return add(key, value ? "true" : "false"); }

  // p50, p99, p99.9 and max of a set of durations [us], as <key>_p50_us and so on; null where nothing was measured.
  JsonLine& quantiles(const std::string& key, const std::vector<std::int64_t>& samples_ns) {
    const auto us = [&](double q) {
      return samples_ns.empty() ? std::nan("") : static_cast<double>(quantile_ns(samples_ns, q)) / 1e3;
    };
    return number(key + "_p50_us", us(0.5))
        .number(key + "_p99_us", us(0.99))
        .number(key + "_p999_us", us(0.999))
        .number(key + "_max_us", us(1.0));
  }

  void print() const { std::printf("{%s}\n", text_.c_str()); }

 private:
  JsonLine& add(const std::string& key, const std::string& value) {
    text_ += (text_.empty() ? "\"" : ", \"") + key + "\": " + value;
    return *this;
  }
  std::string text_;
};

}  // namespace lithe::bench
