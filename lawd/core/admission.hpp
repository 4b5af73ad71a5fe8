// SPDX-License-Identifier: Apache-2.0
// Admission: static rules for a law. The source is checked before it is compiled, the object before it runs.
#pragma once

#include <chrono>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <vector>

namespace lithe::lawd {

// Version of the rules: an object admitted under another version is checked again.
inline constexpr std::string_view kAdmissionRules = "admission 2";

// Why a law is refused: what to change, and where. Line 0 = the law as a whole.
struct Finding {
  std::string gate;
  std::string message;
  int line = 0;
  int column = 0;
};

// One rule: its result and its time.
struct Gate {
  std::string name;
  bool ok = true;
  double ms = 0;
  std::string detail;  // a number for the certificate, or why the rule could not be applied
};

struct Admission {
  std::vector<Gate> gates;
  std::vector<Finding> findings;  // at most kMaxFindings are kept
  std::string not_applied;        // why a rule could not be applied; the law is then neither admitted nor at fault

  static constexpr std::size_t kMaxFindings = 20;
  bool ok() const { return findings.empty() && not_applied.empty(); }
  void refuse(std::string_view gate, std::string message, int line = 0, int column = 0);
  // Applies one rule: `rule` refuses, or sets not_applied, and returns the gate's detail.
  void apply(const char* gate, const std::function<std::string()>& rule);
  nlohmann::json gates_json() const;  // [{gate, ok, ms, detail}]
};

// The compiler's output: the object, and the call graph beside it (same name, ".ci").
struct Compiled {
  std::string object_path;
  std::string source_path;  // as passed to the compiler: tells lines of the law from lines of headers
};

// Both add their gates and findings to `out`.
// Contract: any bytes are safe · nothing of the law runs.
void admit_source(std::string_view source, Admission& out);
void admit_object(const Compiled& compiled, Admission& out);

double since_ms(std::chrono::steady_clock::time_point start);

// Line `wanted` of a text, from 1, at most 200 bytes of it; empty when there is none.
std::string line_of(std::string_view source, int wanted);
// The findings as diagnostics: [{file, line, column, severity, message, text, gate}].
nlohmann::json findings_json(const Admission& admission, const std::string& name, std::string_view source);
// A diagnostic as text: position, message, source line, a caret under the column.
std::string diagnostic_text(const nlohmann::json& diagnostic);

nlohmann::json refuse(const std::string& stage, const std::string& text,
                      nlohmann::json diagnostics = nlohmann::json::array());

// A refusal about the law as a whole, not one line.
nlohmann::json refuse_whole(const std::string& stage, const std::string& name, const std::string& reason);

// The same about one line of `source`; 0 = none.
nlohmann::json refuse_at(const std::string& stage, const std::string& name, const std::string& source, int line,
                         const std::string& reason);

// An object that could not be examined is refused too; this is not the law's fault and is not cached.
nlohmann::json refuse_admission(const Admission& admission, const std::string& name, const std::string& source);

// A step got too little processor time (child.hpp: starved_text()). This is no evidence against the law.
nlohmann::json refuse_starved(const std::string& text);

// The message of a program that exceeded a limit.
bool disk_is_full(const std::string& text);
bool memory_is_full(const std::string& text);

}  // namespace lithe::lawd
