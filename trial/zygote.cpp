// SPDX-License-Identifier: Apache-2.0
// A trial in two processes: first what the child does, which runs the law, then what the zygote does, which answers.
#include "trial/zygote.hpp"

#include <dlfcn.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <utility>

#include "spine/arena/arena.hpp"
#include "spine/core/host/signals.hpp"
#include "spine/law/resident.hpp"
#include "spine/load/law_store.hpp"
#include "spine/robot/robot.hpp"
#include "spine/robot/values.hpp"
#include "trial/sandbox/sandbox.hpp"
#include "trial/sections/sections.hpp"
#include "trial/simulation/simulated_run.hpp"
#include "trial/verdict.hpp"

namespace lithe::trial {
namespace {

using nlohmann::json;

constexpr int kPipe = 3;  // where shed_rights() puts it
constexpr double kRecordedSeconds = 4;
constexpr std::size_t kPastTicks = 1000;
constexpr std::size_t kHeapOfAModel = std::size_t{32} << 20;

Report g_report;

[[noreturn]] void end(int code) {
  for (;;) ask_kernel(SYS_exit_group, code);
}

void tell() {
  const auto bytes = static_cast<long>(sizeof g_report);
  if (ask_kernel(SYS_write, kPipe, reinterpret_cast<long>(&g_report), bytes) != bytes) end(3);
}

void on_signal(int signal, siginfo_t* info, void* context) {
  if (signal == SIGFPE &&
      g_report.refused[0] != '\0') {  // LawHarness::repeat(): the verdict is known, this is its place
    g_report.invalid_pc = program_counter(context);
    g_report.ended = 1;
    tell();
    end(0);
  }
  g_report.crash.signal = signal;
  g_report.crash.pc = program_counter(context);
  if (signal == SIGSYS) {
    g_report.crash.system_call = info->si_syscall;
    g_report.crash.pc = reinterpret_cast<std::uint64_t>(info->si_call_addr);
  } else if (signal == SIGSEGV || signal == SIGBUS) {
    g_report.crash.address = reinterpret_cast<std::uint64_t>(info->si_addr);
  }
  tell();
  end(7);
}

// On an alternate stack, for a law that has used up its stack.
bool listen_for_signals() {
  constexpr std::size_t kStack = 64 << 10;
  void* memory = mmap(nullptr, kStack, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  const stack_t stack{memory, 0, kStack};
  if (memory == MAP_FAILED || sigaltstack(&stack, nullptr) != 0) return false;
  struct sigaction action{};
  action.sa_sigaction = &on_signal;
  action.sa_flags = SA_SIGINFO | SA_ONSTACK | SA_RESETHAND;
  sigfillset(&action.sa_mask);
  for (const int signal : {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT, SIGTRAP, SIGSYS, SIGPROF})
    if (sigaction(signal, &action, nullptr) != 0) return false;
  sigset_t none;
  sigemptyset(&none);
  return sigprocmask(SIG_SETMASK, &none, nullptr) == 0;
}

int fail(const char* words) {
  std::snprintf(g_report.refused.data(), g_report.refused.size(), "%s", words);
  g_report.ended = 1;
  tell();
  return 1;
}

// Handles failures that the law did not cause.
int give_up(const char* words) {
  g_report.unable = 1;
  return fail(words);
}

const LitheLaw* load(const TrialSetup& setup, const TrialRequest& request, std::span<char> why) {
  const LitheLaw* law = nullptr;
  if (request.stage.slot != 0) {
    if (!setup.arena) {
      g_report.unable = 1;
      std::snprintf(why.data(), why.size(), "there is no arena here: send \"object\" instead of \"slot\"");
      return nullptr;
    }
    g_report.image_base = arena::slot_address(request.stage.slot);
    return setup.arena->load(0, request.stage, law, why) == wire::StageResult::staged ? law : nullptr;
  }
  auto store = new load::DlopenStore;  // lives as long as the process
  if (store->load(0, request.stage, law, why) != wire::StageResult::staged) return nullptr;
  Dl_info info{};
  if (dladdr(law, &info) != 0) g_report.image_base = reinterpret_cast<std::uint64_t>(info.dli_fbase);
  return law;
}

// A placed law runs none of its code while it is loaded.
Result<> guard_loading(const TrialRequest& request) {
  return request.stage.slot != 0 ? done() : allow_loading_only(kPipe);
}

Result<> guard_computing(const TrialSetup& setup) {
  if (setup.filtered && block_system_calls()) return done();
  return allow_computing_only(kPipe);
}

// The law's own values, and those the request wants; values outside their range are refused here already.
bool fill_params(const LitheLaw& law, const TrialRequest& request, std::vector<Param>& params) {
  for (std::uint32_t i = 0; i < law.param_count; ++i)
    params.push_back({law.params[i].value, law.params[i].min, law.params[i].max});
  for (const auto& [name, value] : request.params) {
    std::size_t i = 0;
    while (i < params.size() && name != law.params[i].name) ++i;
    const bool known = i < params.size();
    if (known && params[i].min <= value && value <= params[i].max) {
      params[i].value = value;
      continue;
    }
    std::snprintf(g_report.refused.data(), g_report.refused.size(),
                  known ? "the value %g of param %s is outside its range" : "there is no param to be set to %g: %s",
                  value, name.c_str());
    return false;
  }
  return true;
}

struct Part {
  Section section;
  bool (*run)(TrialContext&);
  double share;  // of the box
};
constexpr Part kParts[] = {{Section::benign, &run_benign, 0.1},
                           {Section::loop, &run_loop, 0.4},
                           {Section::replay, &run_replay, 0.15},
                           {Section::hostile, &run_hostile, 0.2},
                           {Section::timing, &run_timing, 0.15}};

// The box is the law's; what its robot takes in the runs comes on top of it.
void run_parts(TrialContext& context, int box_ms) {
  for (const Part& part : kParts) {
    context.report.section = static_cast<std::uint32_t>(part.section);
    const std::int64_t from_ns = context.setup.clock.now_ns();
    const auto share_ns = static_cast<std::int64_t>(part.share * box_ms * 1e6);
    context.deadline_ns = from_ns + share_ns;
    context.law_ns = share_ns;
    const bool passed = part.run(context);
    context.progress().ms = static_cast<double>(context.setup.clock.now_ns() - from_ns) / 1e6;
    if (!passed) return;
    context.progress().done = 1;
  }
}

// Loads the law, runs all sections, writes one Report into the pipe: at the end, or from the handler of the signal that
// ended it. Returns the exit code of the process.
// Contract: in a child, once
int run_trial(const TrialSetup& setup, const TrialRequest& request, const Limits& limits, int pipe_fd) {
  const Recording recording(request.recording, robot::values_hash(setup.robot.values), setup.joints(), setup.dt_s(),
                            kRecordedSeconds);
  if (const auto shed = shed_rights(pipe_fd, limits); !shed) return give_up(shed.message().c_str());
  if (!listen_for_signals()) return give_up("cannot catch the signals of a law");
  if (recording.of_another())
    return give_up(
        "the robot file was changed since the robot started: undo it and end lithe-trial, which starts anew");
  if (const auto shut = guard_loading(request); !shut) return give_up(shut.message().c_str());
  std::snprintf(g_report.doing.data(), g_report.doing.size(), "being loaded");
  char why[256] = "";
  const LitheLaw* law = load(setup, request, why);
  if (law == nullptr) return fail(why);
  if (*law::describe_mismatch(*law, why, sizeof why) != '\0') return fail(why);
  std::vector<Param> params;
  if (!fill_params(*law, request, params)) return fail(std::string(text_of(g_report.refused)).c_str());
  const auto past =
      law->init == nullptr ? std::vector<PastTick>{} : recording.past(kPastTicks, setup.joints(), setup.dt_s());
  const History history{past.data(), static_cast<std::uint32_t>(past.size()), setup.joints(), setup.dt_s()};
  LawHarness one(*law, params, history, setup.clock), other(*law, params, history, setup.clock);
  TrialContext context{setup, *law, recording, one, other, request.budget_ns, 0, g_report, {}, 0};
  context.can_trap = true;
  std::ranges::transform(params, g_report.param_values.begin(), &Param::value);
  g_report.params = static_cast<std::uint32_t>(params.size());
  context.times_ns.reserve(kTimingInputs);
  // A MuJoCo model allocates when meshes touch, and the guard of a simulated run holds its model on the heap; the law
  // must not get a system call for this.
  const bool allocates = setup.robot.plant.kind == robot::PlantKind::mujoco || setup.robot.model.given;
  if (allocates && !keep_heap(kHeapOfAModel)) return give_up("no memory");
  if (const auto shut = guard_computing(setup); !shut) return give_up(shut.message().c_str());
  run_parts(context, request.box_ms);
  g_report.ended = 1;
  tell();
  end(0);  // no destructor may want a system call now
}

constexpr int kBoxMs = 150, kLeastBoxMs = 20, kMostBoxMs = 5000;

json refuse(const char* stage, const std::string& reason) {
  return {{"ok", false}, {"stage", stage}, {"reason", reason}};
}

std::string text(const json& request, const char* key) {
  const auto found = request.find(key);
  return found != request.end() && found->is_string() ? found->get<std::string>() : "";
}

std::int64_t number(const json& request, const char* key, std::int64_t otherwise) {
  const auto found = request.find(key);
  if (found == request.end() || !found->is_number()) return otherwise;
  return found->is_number_unsigned() ? static_cast<std::int64_t>(found->get<std::uint64_t>())
                                     : static_cast<std::int64_t>(found->get<double>());
}

// Of 64 bits: an address or a hash. 0: there is none.
std::uint64_t word(const json& request, const char* key) {
  const auto found = request.find(key);
  return found != request.end() && found->is_number_unsigned() ? found->get<std::uint64_t>() : 0;
}

// "" or what is wrong with the request.
std::string read_request(const json& request, const TrialSetup& setup, TrialRequest& wanted) {
  const std::string object = text(request, "object");
  wanted.stage.slot = static_cast<std::uint32_t>(std::clamp<std::int64_t>(number(request, "slot", 0), 0, UINT32_MAX));
  if (object.empty() && wanted.stage.slot == 0) return "try needs \"object\", or \"slot\" and what place answered";
  if (object.size() >= wanted.stage.path.size()) return "the path of the object is too long";
  std::copy(object.begin(), object.end(), wanted.stage.path.begin());
  wanted.stage.code_bytes = static_cast<std::uint32_t>(number(request, "code_bytes", 0));
  wanted.stage.entry = word(request, "entry");
  wanted.stage.image_hash = word(request, "image_hash");
  const auto budget_ns = static_cast<double>(setup.period_ns()) * setup.robot.swap.budget_share;
  wanted.budget_ns = number(request, "budget_ns", 0);
  if (wanted.budget_ns <= 0) wanted.budget_ns = static_cast<std::int64_t>(budget_ns);
  wanted.box_ms =
      static_cast<int>(std::clamp<std::int64_t>(number(request, "box_ms", kBoxMs), kLeastBoxMs, kMostBoxMs));
  wanted.recording = text(request, "robot");
  const auto params = request.find("params");
  if (params == request.end() || params->is_null()) return "";
  if (!params->is_object()) return "\"params\" must be an object of numbers";
  for (const auto& [name, value] : params->items()) {
    if (!value.is_number()) return "\"params\" must be an object of numbers";
    wanted.params.emplace_back(name, value.get<double>());
  }
  return "";
}

}  // namespace

Result<Zygote> Zygote::make(const std::string& robot_path, int arena_fd) {
  auto robot = robot::load_robot(robot_path);
  if (!robot) return robot.error();
  TrialSetup setup;
  setup.robot = std::move(*robot);
  setup.clock = RawClock::calibrate();
  if (const auto ready = prepare_runs(setup); !ready) return ready.error();
  auto safe_law = run_safe_law(setup.robot);
  if (!safe_law) return safe_law.error();
  std::string arena_text = "no arena was handed over";
  if (arena_fd >= 0 && arena::is_memory(arena_fd)) {
    auto arena = arena::Arena::attach_exec(arena_fd);
    arena_text = arena ? "" : arena.message();
    if (arena) setup.arena = std::make_unique<load::ArenaStore>(std::move(*arena));
    close(arena_fd);  // it could be written through; the mapping stays
  }
  return Zygote(std::move(setup), std::move(arena_text), std::move(*safe_law));
}

Result<> Zygote::install_filter() {
  if (kSanitized) return done();
  const Result<> filtered = allow_trials_only();
  setup_.filtered = static_cast<bool>(filtered);
  return filtered;
}

json Zygote::answer(const std::string& line) {
  const json request = json::parse(line, nullptr, false);
  const std::string verb = request.is_object() ? text(request, "verb") : "";
  json reply = refuse("request", "one JSON object per line, with \"id\" and \"verb\": try or ping");
  if (verb == "try") reply = attempt(request);
  if (verb == "ping") reply = ping();
  if (request.is_object() && request.contains("id")) reply["id"] = request["id"];
  return reply;
}

json Zygote::ping() const {
  return {{"ok", true},
          {"robot", setup_.robot.name},
          {"joints", setup_.joints()},
          {"arena", arena_text_.empty()},
          {"arena_text", arena_text_},
          {"safe_law_text", safe_law_text_}};
}

json Zygote::attempt(const json& request) {
  TrialRequest wanted;
  if (const std::string wrong = read_request(request, setup_, wanted); !wrong.empty()) return refuse("request", wrong);
  Limits limits;
  // What the robot takes is not the law's; under a law the guard has more to do than at rest. A fifth: the run with the
  // State that it carries.
  limits.cpu_ms = wanted.box_ms + wanted.box_ms / 5 + 2 * setup_.run_ms;
  limits.wall_ms = 4 * limits.cpu_ms;
  const auto run = [&] {
    return run_sandboxed([&](int fd) { return run_trial(setup_, wanted, limits, fd); }, limits, sizeof(Report));
  };
  Outcome outcome = run();
  Verdict verdict = verdict_of(outcome, limits);
  if (verdict.out_of_time) {  // time that a hypervisor takes counts as the child's: no_torque is judged by one stall
    limits.cpu_ms *= 2;
    limits.wall_ms *= 2;
    outcome = run();
    verdict = verdict_of(outcome, limits);
  }
  json reply = {{"ok", verdict.ok},
                {"stage", "trial"},
                {"section", name_of(static_cast<Section>(verdict.report.section))},
                {"starved", verdict.starved},
                {"unavailable", verdict.unable},
                {"ms", outcome.wall_ms},
                {"cpu_ms", outcome.cpu_ms},
                {"report", to_json(verdict.report, setup_.plain.baseline, setup_.heavy.baseline, setup_.joints(),
                                   wanted.budget_ns)}};
  if (verdict.ok) reply["warnings"] = warnings(verdict.report, setup_);
  if (!verdict.starved && !verdict.unable) reply["hints"] = hints(verdict.report, setup_, verdict.ok);
  if (!verdict.ok) reply["reason"] = verdict.reason;
  if (verdict.pc_offset != 0) reply["pc_offset"] = verdict.pc_offset;
  return reply;
}

}  // namespace lithe::trial
