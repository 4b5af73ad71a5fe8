// SPDX-License-Identifier: Apache-2.0
#include "lawd/core/answers.hpp"

#include <utility>

namespace lithe::lawd {

using nlohmann::json;

json refuse(const std::string& stage, const std::string& text, json diagnostics) {
  return {{"ok", false}, {"stage", stage}, {"text", text}, {"diagnostics", std::move(diagnostics)}};
}

json refuse_whole(const std::string& stage, const std::string& name, const std::string& reason) {
  return refuse_at(stage, name, "", 0, reason);
}

json refuse_at(const std::string& stage, const std::string& name, const std::string& source, int line,
               const std::string& reason) {
  const json entry = {{"file", name},        {"line", line},      {"column", 0},
                      {"severity", "error"}, {"message", reason}, {"text", line_of(source, line)}};
  return refuse(stage, diagnostic_text(entry), json::array({entry}));
}

json refuse_admission(const Admission& admission, const std::string& name, const std::string& source) {
  json list = findings_json(admission, name, source);
  std::string text;
  for (const json& each : list) text += diagnostic_text(each);
  json refused = refuse("admission", text, list);
  if (admission.findings.empty()) {
    refused = refuse("tools", "the law could not be examined: " + admission.not_applied);
    refused["next"] = "the running law is unchanged; nothing is known against the law: swap again";
  }
  refused["gates"] = admission.gates_json();
  return refused;
}

json refuse_starved(const std::string& text) {
  json refused = refuse("compile", text);
  refused["starved"] = true;
  refused["next"] =
      "the running law is unchanged; nothing is known against the law: try again when the machine is less busy";
  return refused;
}

bool disk_is_full(const std::string& text) {
  return text.find("No space left") != std::string::npos || text.find("Disk quota exceeded") != std::string::npos;
}

bool memory_is_full(const std::string& text) {
  return text.find("out of memory") != std::string::npos || text.find("virtual memory exhausted") != std::string::npos;
}

}  // namespace lithe::lawd
