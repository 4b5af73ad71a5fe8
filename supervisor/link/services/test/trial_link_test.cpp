// SPDX-License-Identifier: Apache-2.0
// Against the real trial, with objects that the real compile service has made.
#include "supervisor/link/services/services.hpp"

#include <gtest/gtest.h>
#include <poll.h>
#include <signal.h>

#include <optional>
#include <string>

#include "spine/core/test/emulation_rig.hpp"
#include "spine/core/time.hpp"

namespace lithe::control {
namespace {

std::string law(const std::string& step) {
  return "#include <lithe/law.hpp>\n"
         "struct Rest {\n"
         "  struct Params { lithe::Param gain{0.01, 0.0, 2.0}; };\n"
         "  struct State { std::uint32_t steps = 0; };\n"
         "  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& e) {\n" +
         step +
         "  }\n"
         "};\n"
         "LITHE_LAW(Rest, \"rest\");\n";
}

const std::string kGood = law("s.steps = 1; e.torque_nm[0] = -p.gain * t.velocity_rad_s[0];\n");
const std::string kCrashes =
    law("if (++s.steps > 50) *(volatile int*)8 = 1;\n e.torque_nm[0] = -p.gain * t.velocity_rad_s[0];\n");

class TrialLinkTest : public testing::Test {
 protected:
  void SetUp() override {
#if defined(__SANITIZE_ADDRESS__)
    GTEST_SKIP() << "a sanitizer cannot live in the sandbox";
#endif
    if (const std::string why = test::why_no_trial(); !why.empty()) GTEST_SKIP() << why;
    lawd_.open_gates();  // the dry run would find some of them
    EXPECT_TRUE(lawd_.start(monotonic_ns()));
    EXPECT_TRUE(trial_.start(monotonic_ns()));
  }
  template <class Start>
  Answer wait_for(Start start) {
    std::optional<Answer> got;
    start([&](const Answer& answer) { got = answer; });
    const std::int64_t deadline_ns = monotonic_ns() + 60 * kNsPerS;
    while (!got && monotonic_ns() < deadline_ns) {
      pollfd wait[2] = {{lawd_.poll_fd(), POLLIN, 0}, {trial_.poll_fd(), POLLIN, 0}};
      ::poll(wait, 2, 10);
      lawd_.serve(monotonic_ns());
      trial_.serve(monotonic_ns());
    }
    return got.value_or(Refusal{"test_timeout", "", ""});
  }
  TrialRequest request_of(const std::string& source) {
    const Answer answer =
        wait_for([&](const LawdLink::Callback& then) { lawd_.compile({"rest.cpp", source}, then, monotonic_ns()); });
    TrialRequest request;
    request.budget_ns = 300'000;
    request.box_ms = 1000;
    const Json* json = std::get_if<Json>(&answer);
    EXPECT_NE(json, nullptr) << std::get<Refusal>(answer).message;
    request.object = json != nullptr ? json->value("object", "") : "";
    return request;
  }
  Answer attempt(const TrialRequest& request) {
    return wait_for([&](const TrialLink::Callback& then) { trial_.attempt(request, then, monotonic_ns()); });
  }

  LawdLink lawd_{LITHE_LAWD, {}, 1};
  TrialLink trial_{LITHE_TRIAL, LITHE_ROBOT, {}};
};

TEST_F(TrialLinkTest, AGoodLawPassesWithAReport) {
  const Answer answer = attempt(request_of(kGood));
  ASSERT_TRUE(std::holds_alternative<Json>(answer)) << std::get<Refusal>(answer).message;
  EXPECT_GT(std::get<Json>(answer)["report"]["timing"]["worst_ns"].get<double>(), 0);
}

TEST_F(TrialLinkTest, ALawThatCrashesIsRefusedWithItsLineAndTheReport) {
  const Answer answer = attempt(request_of(kCrashes));
  ASSERT_TRUE(std::holds_alternative<Refusal>(answer));
  const Refusal& refusal = std::get<Refusal>(answer);
  EXPECT_EQ(refusal.code, "trial_failed");
  EXPECT_NE(refusal.message.find("SIGSEGV"), std::string::npos) << refusal.message;
  EXPECT_TRUE(refusal.detail["trial"].contains("report"));
}

TEST_F(TrialLinkTest, ATrialThatLacksTheArenaDoesNotBlameTheLaw) {
  TrialRequest request = request_of(kGood);
  request.placed.slot = 1;
  const Answer answer = attempt(request);
  ASSERT_TRUE(std::holds_alternative<Refusal>(answer));
  EXPECT_EQ(std::get<Refusal>(answer).code, "trial_unavailable") << std::get<Refusal>(answer).message;
  EXPECT_EQ(std::get<Refusal>(answer).next.find("correct the source"), std::string::npos);
}

TEST_F(TrialLinkTest, ATrialThatDiesRefusesTheLawItHadAndTheNextOneIsServed) {
  const TrialRequest request = request_of(kGood);
  const pid_t first = trial_.pid();
  ::kill(first, SIGSTOP);  // so that the request is certainly in its hands
  const Answer answer = wait_for([&](const TrialLink::Callback& then) {
    trial_.attempt(request, then, monotonic_ns());
    ::kill(first, SIGKILL);
  });
  ASSERT_TRUE(std::holds_alternative<Refusal>(answer));
  EXPECT_EQ(std::get<Refusal>(answer).code, "trial_died");
  EXPECT_TRUE(std::holds_alternative<Json>(attempt(request)));
  EXPECT_NE(trial_.pid(), first);
  EXPECT_EQ(trial_.restarts(), 1U);
}

TEST_F(TrialLinkTest, OneThatIsNotUrgentLetsTheOthersGoFirst) {
  const TrialRequest request = request_of(kGood);
  std::string order;
  wait_for([&](const TrialLink::Callback& then) {
    trial_.attempt(request, [&](const Answer&) { order += "first, "; }, monotonic_ns());
    const auto last = [&order, then](const Answer& answer) {
      order += "idle";
      then(answer);
    };
    trial_.attempt(request, last, monotonic_ns(), TrialLink::Turn::idle);
    trial_.attempt(request, [&](const Answer&) { order += "swap, "; }, monotonic_ns());
  });
  EXPECT_EQ(order, "first, swap, idle");
}

TEST(TrialLinkWithoutATrial, CannotBeStarted) {
  TrialLink trial("/nowhere/lithe-trial", LITHE_ROBOT, {});
  EXPECT_FALSE(trial.start(0));
}

}  // namespace
}  // namespace lithe::control
