// SPDX-License-Identifier: Apache-2.0
// Against the real compile service.
#include "supervisor/link/services/services.hpp"

#include <gtest/gtest.h>
#include <poll.h>
#include <signal.h>

#include <filesystem>
#include <fstream>
#include <optional>
#include <string>
#include <vector>

#include "spine/core/time.hpp"
#include "supervisor/core/process.hpp"
#include "supervisor/link/spine/test/spine_rig.hpp"

namespace lithe::control {
namespace {

class LawdLinkTest : public testing::Test {
 protected:
  LawdLinkTest() { EXPECT_TRUE(lawd_.start(monotonic_ns())); }

  template <class Done>
  void serve_until(Done done) {
    const std::int64_t deadline_ns = monotonic_ns() + 60 * kNsPerS;
    while (!done() && monotonic_ns() < deadline_ns) {
      pollfd wait{lawd_.poll_fd(), POLLIN, 0};
      ::poll(&wait, 1, 10);
      lawd_.serve(monotonic_ns() + ahead_ns_);
    }
  }
  // The service does not get to see anything before this ends.
  void freeze() {
    ::kill(lawd_.pid(), SIGSTOP);
    serve_until([this] { return !work_of_session(lawd_.pid()).wants_to_run; });
  }
  LawdLink::Callback into(std::optional<Answer>& answer) {
    return [&answer](const Answer& got) { answer = got; };
  }
  static std::string code_of(const std::optional<Answer>& answer) {
    const auto* refusal = answer ? std::get_if<Refusal>(&*answer) : nullptr;
    return !answer ? "none" : refusal == nullptr ? "done" : refusal->code;
  }
  // Asked again while a busy machine gives it no processor time: the service yields to everybody.
  Answer compile(const std::string& source) {
    std::optional<Answer> answer;
    for (int i = 0; i < 10 && (!answer || code_of(answer) == "compile_starved"); ++i) {
      answer.reset();
      lawd_.compile({"rest.cpp", source}, into(answer), monotonic_ns());
      serve_until([&answer] { return answer.has_value(); });
    }
    return answer.value_or(Refusal{"test_timeout", "", ""});
  }

  LawdLink lawd_{LITHE_LAWD, {}, 1};
  std::int64_t ahead_ns_ = 0;  // of the clock
};

TEST_F(LawdLinkTest, CompilesALawAndDescribesIt) {
  const Answer answer = compile(kRestLaw);
  ASSERT_TRUE(std::holds_alternative<Json>(answer)) << std::get<Refusal>(answer).message;
  EXPECT_EQ(std::get<Json>(answer)["law"]["name"], "rest");
  EXPECT_EQ(std::get<Json>(answer)["law"]["params"][0]["name"], "gain");
}

TEST_F(LawdLinkTest, AWrongLawIsRefusedWithFileAndLine) {
  const Answer answer = compile("#include <lithe/law.hpp>\nint x = undefined_name;\n");
  ASSERT_TRUE(std::holds_alternative<Refusal>(answer));
  const Refusal& refusal = std::get<Refusal>(answer);
  EXPECT_EQ(refusal.code, "compile_failed");
  EXPECT_NE(refusal.message.find("rest.cpp:2"), std::string::npos) << refusal.message;
  EXPECT_FALSE(refusal.detail["diagnostics"].empty());
}

TEST_F(LawdLinkTest, ADeathRefusesWhatItHadInHandsAndANewOneServesTheNext) {
  const pid_t first = lawd_.pid();
  std::optional<Answer> answer;
  ::kill(first, SIGSTOP);  // so that the request is certainly in its hands
  lawd_.compile({"rest.cpp", kRestLaw}, [&answer](const Answer& got) { answer = got; }, monotonic_ns());
  ::kill(first, SIGKILL);
  serve_until([&answer] { return answer.has_value(); });
  ASSERT_TRUE(answer && std::holds_alternative<Refusal>(*answer));
  EXPECT_EQ(std::get<Refusal>(*answer).code, "lawd_died");
  EXPECT_TRUE(std::holds_alternative<Json>(compile(kRestLaw)));
  EXPECT_NE(lawd_.pid(), first);
  EXPECT_EQ(lawd_.restarts(), 1U);
}

// It lives on, as one that is killed does until it gets the processor: nobody may wait for it without pause.
TEST(LawdLink, AServiceThatClosesItsEndIsNotPolledAnyMoreAndIsReplaced) {
  const std::filesystem::path script = std::filesystem::path(testing::TempDir()) / "closes_its_end.sh";
  std::ofstream(script) << "#!/bin/sh\nexec sleep 60 <&- >&-\n";
  std::filesystem::permissions(script, std::filesystem::perms::owner_all);
  LawdLink lawd(script.string(), {}, 1);
  ASSERT_TRUE(lawd.start(monotonic_ns()));
  const std::int64_t deadline_ns = monotonic_ns() + 60 * kNsPerS;
  while (lawd.restarts() == 0 && monotonic_ns() < deadline_ns) {
    const int before = lawd.poll_fd();
    pollfd wait{before, POLLIN, 0};
    ::poll(&wait, 1, 10);
    lawd.serve(monotonic_ns());
    if ((wait.revents & POLLHUP) != 0 && lawd.restarts() == 0) EXPECT_EQ(lawd.poll_fd(), -1);
  }
  EXPECT_GE(lawd.restarts(), 1U);
}

TEST_F(LawdLinkTest, EightChecksWaitAndTheNinthIsRefusedAtOnce) {
  ASSERT_TRUE(std::holds_alternative<Json>(compile(kRestLaw)));
  freeze();
  const std::int64_t now_ns = monotonic_ns();
  std::vector<std::optional<Answer>> answers(LawdLink::kMaxChecks + 2);  // one is in its hands, eight wait
  for (auto& each : answers) lawd_.check({"rest.cpp", kRestLaw}, into(each), now_ns);
  EXPECT_EQ(code_of(answers.back()), "busy");
  EXPECT_EQ(code_of(answers.front()), "none");
  ::kill(lawd_.pid(), SIGCONT);
  serve_until([&] { return answers[LawdLink::kMaxChecks].has_value(); });
  for (std::size_t i = 0; i <= LawdLink::kMaxChecks; ++i) EXPECT_EQ(code_of(answers[i]), "done") << i;
  std::optional<Answer> again;
  lawd_.check({"rest.cpp", kRestLaw}, into(again), monotonic_ns());
  serve_until([&] { return again.has_value(); });
  EXPECT_EQ(code_of(again), "done");
}

TEST_F(LawdLinkTest, OnlyTheOldestRunsOutOfTimeAndTheOthersGetTheirs) {
  freeze();
  const std::int64_t now_ns = monotonic_ns();
  std::optional<Answer> first, second;
  lawd_.check({"rest.cpp", kRestLaw}, into(first), now_ns);
  lawd_.check({"rest.cpp", kRestLaw}, into(second), now_ns);
  ahead_ns_ = lawd_.limit_ns() + kNsPerS;
  serve_until([&] { return first.has_value(); });
  EXPECT_EQ(code_of(first), "lawd_died");
  EXPECT_EQ(code_of(second), "none");
  serve_until([&] { return second.has_value(); });
  EXPECT_EQ(code_of(second), "done");
}

TEST(LawdLink, WaitsAndLetsTheCompilerWorkAsLongAsTheRobotFileSays) {
  EXPECT_EQ(LawdLink(LITHE_LAWD, {}, 1).limit_ns(), 60 * kNsPerS);
  EXPECT_EQ(LawdLink(LITHE_LAWD, {}, 1, 200).limit_ns(), 600 * kNsPerS);
  for (const char* wrong : {"0", "601", "ten", "2x", "nan"}) {
    Launch launch;
    launch.argv = {LITHE_LAWD, wrong};
    auto lawd = Process::start(launch);
    ASSERT_TRUE(lawd);
    EXPECT_TRUE(lawd->wait(20'000));
    EXPECT_EQ(lawd->exit_code(), 2) << wrong;
  }
}

// It has work and goes on with it, but of the minute that seems to have passed it had next to nothing.
TEST_F(LawdLinkTest, AServiceThatGetsNoProcessorTimeKnowsNothingAgainstTheLaw) {
  ASSERT_TRUE(std::holds_alternative<Json>(compile(kRestLaw)));
  std::optional<Answer> answer;
  lawd_.check({"rest.cpp", kRestLaw + ("// " + std::to_string(monotonic_ns()) + "\n")}, into(answer), monotonic_ns());
  serve_until([&] { return work_of_session(lawd_.pid()).wants_to_run; });
  ahead_ns_ = lawd_.limit_ns() + kNsPerS;
  serve_until([&] { return answer.has_value(); });
  EXPECT_EQ(code_of(answer), "compile_starved");
  ASSERT_TRUE(answer && std::holds_alternative<Refusal>(*answer));
  EXPECT_NE(std::get<Refusal>(*answer).message.find("s of the processor in 61."), std::string::npos)
      << std::get<Refusal>(*answer).message;
}

TEST_F(LawdLinkTest, ASwapGoesBeforeEveryCheckThatWaits) {
  freeze();
  std::vector<std::string> order;
  const auto as = [&order](const char* who) { return [&order, who](const Answer&) { order.push_back(who); }; };
  lawd_.check({"rest.cpp", kRestLaw}, as("in its hands"), monotonic_ns());
  lawd_.check({"rest.cpp", kRestLaw}, as("check"), monotonic_ns());
  lawd_.compile({"rest.cpp", kRestLaw}, as("swap"), monotonic_ns());
  ::kill(lawd_.pid(), SIGCONT);
  serve_until([&] { return order.size() == 3; });
  EXPECT_EQ(order, (std::vector<std::string>{"in its hands", "swap", "check"}));
}

TEST(LawdLinkWithoutAService, RefusesWhatWaitsWhenItCannotBeStarted) {
  LawdLink lawd("/nowhere/lawd", {}, 1);
  ASSERT_FALSE(lawd.start(0));
  std::optional<Answer> answer;
  lawd.compile({"rest.cpp", kRestLaw}, [&answer](const Answer& got) { answer = got; }, 0);
  lawd.serve(LawdLink::kRestartPauseNs);
  ASSERT_TRUE(answer && std::holds_alternative<Refusal>(*answer));
  EXPECT_EQ(std::get<Refusal>(*answer).code, "lawd_failed");
}

}  // namespace
}  // namespace lithe::control
