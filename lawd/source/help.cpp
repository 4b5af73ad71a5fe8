// SPDX-License-Identifier: Apache-2.0
#include "lawd/source/help.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstddef>

#include "lawd/source/admission_words.hpp"
#include "spine/core/lookup.hpp"
#include "spine/core/text.hpp"

namespace lithe::lawd {
namespace {

// The text in quotes before `end`, or "" when there is none.
std::string quoted_before(const std::string& message, std::size_t end) {
  if (end == std::string::npos || end == 0) return "";
  const std::size_t from = message.rfind('\'', end - 1);
  return from == std::string::npos ? "" : message.substr(from + 1, end - from - 1);
}

std::string quoted_after(const std::string& message, std::string_view words) {
  const std::size_t at = message.find(words);
  if (at == std::string::npos) return "";
  const std::size_t from = at + words.size();
  return message.substr(from, message.find('\'', from) - from);
}

// What other programs call the fields of the contract.
struct Alias {
  std::string_view word, field;
};
constexpr auto kAliases = std::to_array<Alias>({{"q", "position_rad"},
                                                {"pos", "position_rad"},
                                                {"angle", "position_rad"},
                                                {"theta", "position_rad"},
                                                {"qd", "velocity_rad_s"},
                                                {"dq", "velocity_rad_s"},
                                                {"vel", "velocity_rad_s"},
                                                {"speed", "velocity_rad_s"},
                                                {"tau", "torque_nm"},
                                                {"effort", "torque_nm"},
                                                {"ref", "setpoint_position_rad"},
                                                {"target", "setpoint_position_rad"},
                                                {"desired", "setpoint_position_rad"},
                                                {"goal", "setpoint_position_rad"},
                                                {"time", "t_s"},
                                                {"n", "joints"},
                                                {"size", "joints"},
                                                {"joint_count", "joints"},
                                                {"num_joints", "joints"}});

// Smaller is nearer: a name that is part of the other counts as nearly the same.
std::size_t farness(std::string_view wanted, std::string_view field) {
  for (const Alias& each : kAliases)
    if (field == each.field && (wanted == each.word || wanted.starts_with(std::string(each.word) + "_"))) return 0;
  if (has_text(field, wanted) || has_text(wanted, field)) return 1 + (field.starts_with(wanted) ? 0 : 1);
  return 2 + edit_distance(wanted, field);
}

std::string listed(std::vector<std::string> fields, std::string_view wanted) {
  std::ranges::stable_sort(
      fields, [wanted](const std::string& a, const std::string& b) { return farness(wanted, a) < farness(wanted, b); });
  return joined(fields);
}

// The arguments of step(), by the letter that the contract gives them.
struct Argument {
  const char *type, *letter, *what;
};
constexpr auto kArguments = std::to_array<Argument>({{"Tick", "t", "const lithe::Tick& t"},
                                                     {"Params", "p", "const Params& p"},
                                                     {"State", "s", "State& s"},
                                                     {"Effort", "u", "lithe::Effort& u"}});

// What a message says, and what to do. The first match counts.
struct Advice {
  std::string_view part, also, says;
};
constexpr std::string_view kPerJoint =
    "an array has one number per joint: compute with one joint at a time, [j] in for (std::uint32_t j = 0; "
    "j < t.joints; ++j)";
constexpr std::string_view kTuned =
    "Params are tuned from outside, and a law cannot change them: change a number in State instead (double kp = 4;)";
constexpr auto kAdvice = std::to_array<Advice>({
    {"no match for 'operator=' (operand types are 'const lithe::Param'", "", kTuned},
    {"no match for 'operator", "JointArray", kPerJoint},
    {"no match for 'operator", "std::array<double", kPerJoint},
    {"cannot convert", "JointArray", kPerJoint},
    {"read-only", "lithe::Tick::", "t is the input, and a law cannot change it: its output is u.torque_nm[j]"},
    {"read-only", "Params::", kTuned},
    {"const lithe::Param' as 'this'", "", kTuned},
    {"in read-only object", "", "step() gets t and p to read: what a law changes belongs in State, its output in u"},
    {"in static member function", "", "step() is static: what it remembers is in State, what is tuned in Params"},
    {"invalid use of member", "static", "step() is static: what it remembers is in State, what is tuned in Params"},
    {"without object", "", "step() is static: what it remembers is in State, what is tuned in Params"},
    {"at end of input", "", "the text ends too early: send the whole file, to LITHE_LAW(Type, \"name\");"},
});

// Names of the library that laws write without std::.
constexpr auto kOfStd = std::to_array<std::string_view>(
    {"array", "clamp", "min", "max", "lerp", "numbers", "numeric_limits", "span", "fill", "copysign", "hypot"});
// Of a library that a law need not include.
constexpr auto kOfContract =
    std::to_array<std::string_view>({"Tick", "Effort", "Param", "History", "PastTick", "JointArray", "kMaxJoints",
                                     "kSampleStale", "kBrainStale", "kAbsent"});

}  // namespace

std::vector<std::string> fields_of(const Tokens& tokens, std::string_view name) {
  const std::vector<Token>& list = tokens.list;
  std::size_t i = 0;
  while (i + 2 < list.size() && !(list[i].text == "struct" && list[i + 1].text == name && list[i + 2].text == "{")) ++i;
  if (i + 2 >= list.size()) return {};
  std::vector<std::string> fields, statement;
  int depth = 0, angles = 0;  // of braces, brackets and parentheses; of < >
  bool value = false, function = false;
  for (i += 3; i < list.size(); ++i) {
    const std::string& text = list[i].text;
    const bool word = list[i].kind == TokenKind::word;
    const bool opens = text == "{" || text == "(" || text == "[", closes = text == "}" || text == ")" || text == "]";
    if (closes && depth-- == 0) break;  // of the struct
    if (depth == 0 && !value && angles == 0 && i + 1 < list.size() && word) {
      const std::string& next = list[i + 1].text;
      if (next == "{" || next == "=" || next == ";" || next == "," || next == "[") statement.push_back(text);
    }
    if (depth == 0 && !value && text == "(") function = true;
    if (depth == 0 && text == "static") function = true;  // no field of an object
    if (depth == 0 && text == "=") value = true;
    if (depth == 0 && !value && (text == "<" || text == ">")) angles += text == "<" ? 1 : -1;
    if (opens) ++depth;
    if (depth == 0 && text == ",") value = false;
    const bool body_ends = function && closes && text == "}" && depth == 0;
    if (depth != 0 || (text != ";" && !body_ends)) continue;
    if (!function) fields.insert(fields.end(), statement.begin(), statement.end());
    statement.clear();
    value = function = false;
    angles = 0;
  }
  return fields;
}

Help::Help(std::string_view source, std::string_view contract)
    : source_(tokenise(source)), contract_(tokenise(contract)) {}

std::vector<std::string> Help::fields(std::string_view type) const {
  std::vector<std::string> found = fields_of(source_, type);
  return found.empty() ? fields_of(contract_, type) : found;
}

std::string Help::with_help(const std::string& message) const {
  std::string help = about_field(message);
  if (help.empty()) help = about_name(message);
  for (const Advice& each : kAdvice)
    if (help.empty() && has_text(message, each.part) && has_text(message, each.also)) help = each.says;
  return help.empty() ? message : message + ": " + help;
}

// "'const struct lithe::Tick' has no member named 'dt'; did you mean 'dt_s'?"
std::string Help::about_field(const std::string& message) const {
  constexpr std::string_view kNoMember = "' has no member named '";
  const std::size_t at = message.find(kNoMember);
  if (at == std::string::npos) return "";
  std::string type = quoted_before(message, at);
  type = type.substr(type.find_last_of(": ") + 1);
  const std::string wanted = quoted_after(message, kNoMember);
  if (type == "Param") return "a Param is a number: write p." + std::string("NAME alone, without .") + wanted;
  const std::vector<std::string> own = fields(type);
  if (own.empty()) return type == "State" || type == "Params" ? type + " has no fields yet: declare it there" : "";
  std::string help = type + " has " + listed(own, wanted);
  for (const Argument& each : kArguments) {
    const std::vector<std::string> others = fields(each.type);
    if (each.type != type && contains(others, wanted)) help += "; " + wanted + " is a field of " + each.type;
  }
  return help;
}

// "'position_rad' was not declared in this scope"; "'Tick' does not name a type"; "'clmp' is not a member of 'std'"
std::string Help::about_name(const std::string& message) const {
  std::string name;
  for (const char* words : {"' was not declared in this scope", "' does not name a type", "' has not been declared",
                            "' is not a member of 'std'"}) {
    if (name.empty()) name = quoted_before(message, message.find(words));
  }
  if (name.empty()) return "";
  if (name.starts_with("std::")) name.erase(0, 5);
  if (name == "lithe" || name == "LITHE_LAW") return "the file begins with #include <lithe/law.hpp>";
  if (name == "std") return "the file begins with #include <lithe/law.hpp>, which brings <cmath>, <array>, <algorithm>";
  const bool of_std = message.find("is not a member of") != std::string::npos;
  for (const std::string_view why : {why_std_name_is_refused(name), why_call_is_refused(name)})
    if (!why.empty()) return std::string(why);
  if (of_std) return "a law has " + allowed_headers_text();
  if (contains(kOfStd, name)) return "write std::" + name;
  if (contains(kOfContract, name)) return "write lithe::" + name;
  for (const Argument& each : kArguments) {
    const std::vector<std::string> own = fields(each.type);
    if (contains(own, name))
      return fmt::format("it is a field of {}: write {}.{} in step({})", each.type, each.letter, name, each.what);
  }
  return "";
}

}  // namespace lithe::lawd
