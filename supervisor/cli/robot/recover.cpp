// SPDX-License-Identifier: Apache-2.0
// `lithe recover`: sends the command, then waits until it has ended.
#include <fmt/format.h>

#include <chrono>
#include <string>
#include <thread>

#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/core/talk.hpp"

namespace lithe::cli {
namespace {

constexpr auto kLookEvery = std::chrono::milliseconds(100);

// The Spine's reason when recover failed.
std::string last_stop(const Context& context) {
  const Answer answer = try_ask(context, "events", Json::object());
  std::string text;
  if (const Json* result = std::get_if<Json>(&answer)) {
    for (const Json& event : (*result)["events"])
      if (event.value("kind", "") == "safe_stop") text = event.value("text", "");
  }
  return text;
}

Refusal why_not(const Context& context, const Json& status) {
  const std::string mode = status.value("mode", "?"), fault = status.value("fault", "none");
  if (mode != "safe_stop") {
    return {"refused_mode", fmt::format("the recovery was ended from elsewhere: the robot is in mode {}", mode),
            "see how the robot is: lithe status"};
  }
  const std::string said = last_stop(context);
  return {fault, fmt::format("not recovered: {}", said.empty() ? fault : said),
          fault == "recover_failed" ? "take the load away, move the joint by hand (lithe disarm), or raise "
                                      "recover_torque_share in [guard]; then again: lithe recover"
                                    : "find the cause (lithe status), then: lithe reset, then again: lithe recover"};
}

}  // namespace

int recover(const Context& context) {
  ask(context, "recover", Json::object());
  Json status;
  do {
    if (!status.is_null()) std::this_thread::sleep_for(kLookEvery);
    status = ask(context, "status", Json::object());
    if (status.value("mode", "") != "recover") throw why_not(context, status);
  } while (status.value("recovering", true));
  return finish(context, status, [](const Json& now) {
    fmt::print("every joint is inside its limits and held there (mode {})\nnext: lithe arm, or lithe disarm\n",
               now.value("mode", "?"));
  });
}

}  // namespace lithe::cli
