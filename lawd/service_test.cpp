// SPDX-License-Identifier: Apache-2.0
#include "lawd/service.hpp"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/stat.h>

#include <chrono>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <optional>
#include <set>
#include <string>
#include <string_view>

#include "lawd/run/child.hpp"
#include "lawd/run/files.hpp"
#include "lawd/test/lawd_rig.hpp"
#include "spine/core/host/files.hpp"
#include "spine/core/test/emulation_rig.hpp"

namespace lithe::lawd {
namespace {

using nlohmann::json;

TEST_F(ServiceTest, LawIsCompiledDescribedAndCached) {
  const std::string source = LawText{}.source();
  const json made = compile(service_, source);
  ASSERT_TRUE(made["ok"]) << made;
  EXPECT_EQ(made["id"], 7);
  EXPECT_FALSE(made["cached"]);
  EXPECT_EQ(made["law"]["name"], "test");
  EXPECT_EQ(made["law"]["params"][0]["name"], "kp_nm_rad");
  EXPECT_EQ(made["law"]["params"][0]["max"], 2.0);
  EXPECT_EQ(made["law"]["state"][0], (json{{"name", "sum_rad"}, {"type", "float64"}, {"count", 1}}));
  const json again = compile(service_, source);
  EXPECT_TRUE(again["cached"]);
  EXPECT_EQ(again["object"], made["object"]);
  EXPECT_EQ(again["hash"], made["hash"]);
}

TEST_F(ServiceTest, DamagedCacheEntryIsNoticedAndBuiltAnew) {
  const std::string source = LawText{}.source();
  const json made = compile(service_, source);
  ASSERT_TRUE(made["ok"]);
  const std::string object = made["object"];
  const std::string whole = *read_file(object);
  std::string flipped = whole;
  flipped[flipped.size() / 2] = static_cast<char>(flipped[flipped.size() / 2] ^ 1);
  for (const std::string& damaged : {flipped, whole.substr(0, 100), std::string()}) {
    std::ofstream(object, std::ios::binary) << damaged;
    const json again = compile(service_, source);
    EXPECT_TRUE(again["ok"]);
    EXPECT_FALSE(again["cached"]);
    EXPECT_EQ(read_file(object), whole);
  }
  std::ofstream(object.substr(0, object.size() - 3) + ".json") << "{\"ok\":tr";
  EXPECT_FALSE(compile(service_, source)["cached"]);
  std::filesystem::remove(object);
  EXPECT_FALSE(compile(service_, source)["cached"]);
  EXPECT_TRUE(compile(service_, source)["cached"]);
}

TEST_F(ServiceTest, CompilerErrorNamesTheLineOfTheLaw) {
  const json reply = refused({.body = "u.torque_nm[0] = unknown_gain;"}, "compile");
  EXPECT_EQ(line(reply), 6);
  EXPECT_EQ(reply["diagnostics"][0]["file"], "law.cpp");
  EXPECT_NE(first(reply).find("unknown_gain"), std::string::npos);
  EXPECT_NE(reply["text"].get<std::string>().find("law.cpp:6:"), std::string::npos);
}

// One user's checkouts share a cache.
TEST_F(ServiceTest, TheSameContractInAnotherFolderIsQuotedToo) {
  const std::string wrong =
      "#include <lithe/law.hpp>\nstruct L { struct Params {}; struct State {}; static void step(int) {} };\n"
      "LITHE_LAW(L, \"l\");\n";
  const std::string here = first(compile(service_, wrong));
  const std::string elsewhere = cache_.path() + "/another";
  std::filesystem::copy(find_contract_dir(), elsewhere, std::filesystem::copy_options::recursive);
  ::setenv("LITHE_CONTRACT_DIR", elsewhere.c_str(), 1);
  Service there(cache_.path());
  ::unsetenv("LITHE_CONTRACT_DIR");
  EXPECT_EQ(first(compile(there, wrong)), here);
}

// Past admission, which refuses such an #include before a compiler reads it.
TEST_F(ServiceTest, AnIncludedFileIsNamedAndNeverQuoted) {
  const std::string private_file = cache_.path() + "/private.txt";
  std::ofstream(private_file)
      << "open_sesame is the word;\n#error open_sesame\nstatic_assert(false, \"LITHE: open_sesame\");\n";
  const std::string law = "#include <lithe/law.hpp>\n#include \"" + private_file + "\"\nint wrong = own_word;\n";
  const json reply = compile(service_, law, "law.cpp", false);
  EXPECT_EQ(reply["stage"], "compile");
  EXPECT_EQ(reply.dump().find("open_sesame"), std::string::npos) << reply["text"];
  EXPECT_NE(reply["text"].get<std::string>().find("private.txt:2:"), std::string::npos) << reply["text"];
  EXPECT_NE(reply["text"].get<std::string>().find("own_word"), std::string::npos) << "the law's own lines are quoted";
}

TEST_F(ServiceTest, FileWithoutALawIsRefused) {
  const json reply = compile(service_, "int x;\n");
  EXPECT_EQ(reply["stage"], "admission");
  EXPECT_NE(reply["text"].get<std::string>().find("LITHE_LAW"), std::string::npos);
}

#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)  // there the compiler's memory is not limited
TEST_F(ServiceTest, CompilerThatNeedsAllMemoryIsStoppedWithTheReason) {
  if (const std::string why = test::why_memory_is_unlimited(); !why.empty()) GTEST_SKIP() << why;
  std::string bomb = "#define A0 x\n";
  for (int i = 1; i < 40; ++i) {
    const std::string last = " A" + std::to_string(i - 1);
    bomb += "#define A" + std::to_string(i) + last + last + "\n";
  }
  const json reply = compile(service_, bomb + "int a = A39;\n", "law.cpp", false);  // past admission, which counts
  EXPECT_EQ(reply["stage"], "compile");
  EXPECT_NE(first(reply).find("1 GiB of memory"), std::string::npos) << reply["text"];
}
#endif

TEST_F(ServiceTest, UnknownFunctionIsNamed) {
  const json reply = refused({.body = "void helper(int); helper(3);"}, "admission");
  EXPECT_NE(first(reply).find("helper(int)"), std::string::npos) << reply["text"];
}

TEST_F(ServiceTest, CrashHangExitAndNanAreRefusedWithTheReason) {
  const json crash = refused({.body = "*(volatile int*)nullptr = 1;"}, "dry_run");
  EXPECT_NE(first(crash).find("SIGSEGV"), std::string::npos);
  const json loop = refused({.body = "for (;;) s.sum_rad = *(volatile double*)&s.sum_rad;"}, "dry_run");
  EXPECT_NE(first(loop).find("did not return"), std::string::npos);
  for (const json& each : {crash, loop}) EXPECT_GT(each["diagnostics"][0].value("line", 0), 0) << each;
  const json ended = compile(service_, LawText{.body = "__builtin_exit(0);"}.source(), "law.cpp", false);
  EXPECT_EQ(ended["stage"], "dry_run");
  EXPECT_NE(first(ended).find("ended its process"), std::string::npos);
  const json nan = refused({.body = "u.torque_nm[1] = std::sqrt(-1 - t.t_s);"}, "dry_run");
  EXPECT_NE(first(nan).find("torque_nm[1] is not finite"), std::string::npos) << nan["text"];
  const json sensor = refused({.body = "u.torque_nm[0] = 0.1 * t.sensor[0];"}, "dry_run");
  EXPECT_NE(first(sensor).find("no sensor is valid (NaN)"), std::string::npos) << sensor["text"];
  const json pole = refused({.body = "u.torque_nm[0] = t.position_rad[0] / t.velocity_rad_s[0];"}, "dry_run");
  EXPECT_NE(first(pole).find("in dry step 0, on harmless inputs"), std::string::npos) << pole["text"];
  EXPECT_EQ(first(pole).find("sensor"), std::string::npos) << "at rest it is 0 / 0, with any sensor";
}

TEST_F(ServiceTest, LawThatIsNowAndThenTooSlowForTheRobotIsRefused) {
  const std::string slow = LawText{.body =
                                       "if (t.tick % 500 == 7) for (int i = 0; i < 200'000; ++i) "
                                       "s.sum_rad = *(volatile double*)&s.sum_rad + 1;"}
                               .source();
  const json reply = compile(service_, slow, "law.cpp", true, 20'000);
  EXPECT_FALSE(reply["ok"]);
  EXPECT_EQ(reply["stage"], "dry_run");
  EXPECT_NE(first(reply).find("the robot leaves it 20.0 us"), std::string::npos) << reply["text"];
  const json patient = compile(service_, slow, "law.cpp", true, 1'000'000'000);
  EXPECT_TRUE(patient["ok"]) << "another robot has the time: " << patient;
  EXPECT_TRUE(patient["cached"]);
  EXPECT_GT(patient["dry_step_max_ns"], 20'000);
  EXPECT_FALSE(compile(service_, slow, "law.cpp", true, 20'000)["ok"]) << "from the cache too";
  EXPECT_TRUE(compile(service_, slow)["ok"]) << "no budget, no judgement";
}

TEST_F(ServiceTest, ATimeThatWasMeasuredOnADisturbedMachineIsMeasuredAgain) {
  const std::string source = LawText{}.source();
  const json first_time = compile(service_, source);
  ASSERT_TRUE(first_time["ok"]) << first_time;
  const std::string path = cache_.path() + "/laws/" + std::string(first_time["hash"]) + ".json";
  json entry = json::parse(read_file(path).value());
  entry["dry_step_max_ns"] = 600e6;
  ASSERT_EQ(write_file_whole(path, entry.dump()), "");
  const json again = compile(service_, source, "law.cpp", true, 500'000'000);
  EXPECT_TRUE(again["ok"]) << again;
  EXPECT_FALSE(again["cached"]);
  EXPECT_TRUE(compile(service_, source, "law.cpp", true, 500'000'000)["cached"]) << "the new time was kept";
}

TEST_F(ServiceTest, BudgetThatIsNoneIsRefused) {
  for (const json& budget : {json(0), json(-5), json("300"), json(false)})
    EXPECT_EQ(compile(service_, LawText{}.source(), "law.cpp", true, budget)["stage"], "request") << budget;
}

TEST_F(ServiceTest, RefusedLawLeavesNothingInTheCache) {
  refused({.body = "u.torque_nm[0] = 1 / 0.0;"}, "dry_run");
  std::size_t entries = 0;
  for (const auto& entry : std::filesystem::directory_iterator(cache_.path() + "/laws")) entries += entry.exists();
  EXPECT_EQ(entries, 0u);
}

// Of a service that was killed while it compiled; not of one that still does.
TEST_F(ServiceTest, WhatAKilledServiceLeftIsSweptAtTheStart) {
  const std::string folder = cache_.path() + "/laws";
  const ScratchDir in_use(folder);
  EXPECT_EQ(std::string(std::getenv("TMPDIR")), in_use.path()) << "where the compiler keeps its own files";
  std::filesystem::create_directories(folder + "/scratch.killed/below");
  std::ofstream(folder + "/scratch.killed/cc.s") << "x";
  const Service next(cache_.path(), -1);
  EXPECT_FALSE(std::filesystem::exists(folder + "/scratch.killed"));
  EXPECT_TRUE(std::filesystem::exists(in_use.path()));
}

TEST(KeepNewest, RemovesWholeLawsOldestFirstUntilTheRestFits) {
  const TestCache cache;
  const std::filesystem::path folder = std::filesystem::path(cache.path()) / "laws";
  std::filesystem::create_directories(folder);
  const auto now = std::filesystem::file_time_type::clock::now();
  for (int law = 0; law < 4; ++law) {
    for (const char* end : {".so", ".o", ".json"}) {
      const auto path = folder / ("law" + std::to_string(law) + end);
      std::ofstream(path) << std::string(100, 'x');
      // Law 0 is the oldest, but was used last: its .json was touched.
      const bool used = law == 0 && std::string_view(end) == ".json";
      std::filesystem::last_write_time(path, now - std::chrono::hours(used ? 0 : 4 - law));
    }
  }
  const auto left = [&] {
    std::set<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator(folder)) names.insert(entry.path().filename());
    return names;
  };
  keep_newest(folder, 1200);
  EXPECT_EQ(left().size(), 12U) << "it fits";
  keep_newest(folder, 899);
  EXPECT_EQ(left(), (std::set<std::string>{"law0.json", "law0.o", "law0.so", "law3.json", "law3.o", "law3.so"}));
  keep_newest(folder / "absent", 0);
}

TEST_F(ServiceTest, WhatAToolWasMissingForIsRefusedAndForgotten) {
  const std::string path = getenv("PATH"), source = LawText{}.source();
  std::ofstream(cache_.path() + "/objdump") << "#!/bin/sh\nexit 1\n";
  ASSERT_EQ(chmod((cache_.path() + "/objdump").c_str(), 0700), 0);
  setenv("PATH", (cache_.path() + ":" + path).c_str(), 1);
  const json reply = compile(service_, source);
  setenv("PATH", path.c_str(), 1);
  EXPECT_FALSE(reply["ok"]) << reply;
  EXPECT_EQ(reply["stage"], "tools");
  EXPECT_NE(reply["next"].get<std::string>().find("swap again"), std::string::npos);
  const json again = compile(service_, source);
  EXPECT_TRUE(again["ok"]) << again;
  EXPECT_FALSE(again["cached"]);
}

TEST_F(ServiceTest, NonsenseIsAnsweredAndTheServiceGoesOn) {
  for (const char* line :
       {"{", "[]", "{\"id\":1}", "{\"verb\":3}", "{\"verb\":\"compile\"}", "{\"verb\":\"compile\",\"source\":[1]}",
        "{\"verb\":\"compile\",\"source\":\"int x;\"}", "{\"verb\":\"compile\",\"source\":\"int x;\",\"joints\":33}",
        "{\"verb\":\"dance\"}", "\xff\xfe"}) {
    EXPECT_FALSE(service_.answer(line)["ok"]) << line;
  }
  EXPECT_FALSE(compile(service_, std::string(2 << 20, ' '))["ok"]);
  EXPECT_TRUE(compile(service_, LawText{}.source(), "../../etc/passwd")["ok"]);
  EXPECT_TRUE(service_.answer("{\"verb\":\"ping\",\"id\":9}")["ok"]);
}

TEST(Service, CacheThatCannotBeWrittenIsOneClearMessage) {
  TestCache cache;
  std::ofstream(cache.path() + "/laws") << "a file where a folder should be";
  Service service(cache.path());
  const json reply = compile(service, LawText{}.source());
  EXPECT_EQ(reply["stage"], "cache");
  EXPECT_NE(reply["text"].get<std::string>().find("LITHE_CACHE_DIR"), std::string::npos) << reply;
}

// A compiler that does what the real one does when its disk is full.
TEST(Service, FullDiskIsOneClearMessage) {
  TestCache cache;
  const std::string fake = cache.path() + "/fake-compiler";
  std::ofstream(fake) << "#!/bin/sh\ncase \"$1\" in --version) echo fake 1;; -print-prog-name=ld) echo ld;;\n"
                      << "*) echo 'fatal error: error writing to law.o: No space left on device' >&2; exit 1;; esac\n";
  ASSERT_EQ(chmod(fake.c_str(), 0700), 0);
  setenv("LITHE_CXX", fake.c_str(), 1);
  Service service(cache.path());
  unsetenv("LITHE_CXX");
  const json reply = compile(service, LawText{}.source());
  EXPECT_EQ(reply["stage"], "cache");
  EXPECT_NE(reply["text"].get<std::string>().find("is full"), std::string::npos) << reply;
}

// A service whose compiler is a shell script; `work` is what it does with a law.
class FakeCompiler {
 public:
  FakeCompiler(const std::string& work, const Limits& limits) {
    const std::string fake = cache_.path() + "/fake-compiler";
    std::ofstream(fake)
        << "#!/bin/sh\ncase \"$*\" in --version) echo fake 1; exit;; -print-prog-name=ld) echo ld; exit;;\n"
        << "*c++-header*) exit 1;; esac\n"
        << work << "\n";
    EXPECT_EQ(chmod(fake.c_str(), 0700), 0);
    setenv("LITHE_CXX", fake.c_str(), 1);
    service_.emplace(cache_.path(), -1, limits);
    unsetenv("LITHE_CXX");
  }
  json compile_a_law() { return compile(*service_, LawText{}.source()); }

 private:
  TestCache cache_;
  std::optional<Service> service_;
};

TEST(Service, CompilerWithoutProcessorTimeIsNotTheLawsFault) {
  FakeCompiler stands("kill -STOP $$", {.wall_ms = 100});
  const json reply = stands.compile_a_law();
  EXPECT_FALSE(reply["ok"]) << reply;
  EXPECT_TRUE(reply.value("starved", false)) << reply;
  EXPECT_NE(reply["text"].get<std::string>().find("the compiler got"), std::string::npos) << reply;
  EXPECT_NE(reply.value("next", "").find("less busy"), std::string::npos) << reply;
}

TEST(Service, CompilerThatUsedItsProcessorTimeIs) {
  FakeCompiler works("while :; do :; done", {.wall_ms = 2'000'000, .cpu_s = 20});
  set_time_factor(0.05);
  const json reply = works.compile_a_law();
  set_time_factor(1);
  EXPECT_FALSE(reply["ok"]) << reply;
  EXPECT_FALSE(reply.value("starved", false)) << reply;
  EXPECT_NE(reply["text"].get<std::string>().find("swap.compile_s of the robot file allows it 1 s"), std::string::npos)
      << reply;
  EXPECT_NE(reply["text"].get<std::string>().find("make the law smaller"), std::string::npos) << reply;
}

TEST(Service, MissingCompilerSaysWhatToInstall) {
  TestCache cache;
  setenv("LITHE_CXX", "no-such-compiler", 1);
  Service service(cache.path());
  unsetenv("LITHE_CXX");
  EXPECT_NE(compile(service, LawText{}.source())["text"].get<std::string>().find("apt install"), std::string::npos);
}

TEST(Child, EndlessWorkIsKilledWithAllItStarted) {
  Limits limits;
  limits.wall_ms = 100;
  const Outcome outcome = run_child(
      [](int) {
        if (fork() == 0) signal(SIGTERM, SIG_IGN);
        for (;;) pause();
        return 0;
      },
      limits);
  EXPECT_TRUE(outcome.timed_out);
  EXPECT_TRUE(outcome.starved);
}

// As a compiler's driver does, which waits for the process that compiles.
TEST(Child, ProcessorTimeOfWhatItStartedCounts) {
  int adopts = 0;
  if (prctl(PR_GET_CHILD_SUBREAPER, &adopts) != 0) GTEST_SKIP() << "PR_SET_CHILD_SUBREAPER is unknown here (qemu-user)";
  Limits limits;
  limits.wall_ms = 3'000;
  const Outcome outcome = run_child(
      [](int out_fd) {
        if (fork() == 0) {
          while (clock() < CLOCKS_PER_SEC / 10) {
          }
          dprintf(out_fd, "done");
        }
        for (;;) pause();
        return 0;
      },
      limits);
  EXPECT_TRUE(outcome.timed_out);
  EXPECT_EQ(outcome.output, "done");
  EXPECT_GE(outcome.cpu_ms, 90);
  EXPECT_TRUE(outcome.starved);  // far from half of what it may take
}

}  // namespace
}  // namespace lithe::lawd
