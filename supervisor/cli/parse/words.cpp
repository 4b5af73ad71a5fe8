// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/parse/words.hpp"

#include <iostream>
#include <utility>

#include "supervisor/cli/core/talk.hpp"
#include "supervisor/cli/parse/reference.hpp"

namespace lithe::cli {
namespace {

// Headings of `lithe help`, in the order in which they are shown.
constexpr const char* kRobot = "The robot";
constexpr const char* kMotion = "Motion";
constexpr const char* kLaws = "Laws";
constexpr const char* kHardware = "Hardware and simulation";
constexpr const char* kHelp = "Help";

void add_run(CLI::App& app, Words& words) {
  CLI::App* run =
      app.add_subcommand("run", "start a robot and supervise it until Ctrl-C; adopts a Spine that already ticks");
  run->group(kRobot);
  run->add_option("ROBOT", words.run.config_path, "robot file")->required();
  run->add_option("--law", words.run.law, "law to start with, instead of the file's")->type_name("FILE");
  run->add_flag("--no-arm", words.no_arm, "leave the drives off until lithe arm");
  run->add_flag("--ungated", words.ungated, "for tests: no admission, no dry run, no trial of laws");
  run->callback([&words] {
    words.run.arm = !words.no_arm;
    words.run.gates = !words.ungated;
    words.run.json = words.context.json;
    words.code = control::run_robot(words.run);
  });
}

CLI::AsNumberWithUnit seconds() {
  return CLI::AsNumberWithUnit(std::map<std::string, double>{{"s", 1.0}, {"ms", 1e-3}, {"us", 1e-6}});
}

void add_units(CLI::App& verb, Context& context) {
  verb.add_option("--units", context.units, "of angles: deg (default) or rad")
      ->type_name("UNITS")
      ->check(CLI::IsMember({"deg", "rad"}));
}

void add_plain(CLI::App& app, Words& words, const char* group,
               const std::vector<std::pair<const char*, const char*>>& verbs) {
  for (const auto& [verb, about] : verbs) {
    app.add_subcommand(verb, about)->group(group)->callback([&words, verb = verb] {
      words.code = command(words.context, verb);
    });
  }
}

void add_robot(CLI::App& app, Words& words) {
  app.add_subcommand("list", "running robots, with or without a supervisor")->group(kRobot)->callback([&words] {
    words.code = list(words.context);
  });
  CLI::App* show = app.add_subcommand("status", "alarms, mode, law, timing, joints");
  add_units(*show, words.context);
  show->group(kRobot)->callback([&words] { words.code = status(words.context); });
  CLI::App* live = app.add_subcommand("top", "status, live");
  live->add_option("--turns", words.turns, "end after this many updates")->type_name("N");
  add_units(*live, words.context);
  live->group(kRobot)->callback([&words] { words.code = top(words.context, words.turns); });
  CLI::App* log = app.add_subcommand("events", "what happened");
  log->add_option("--since", words.since, "only events after this cursor")->type_name("CURSOR");
  log->add_flag("--follow,-f", words.follow, "go on until Ctrl-C");
  log->group(kRobot)->callback([&words] { words.code = events(words.context, words.since, words.follow); });
  app.add_subcommand("estop", "stop now, with or without a supervisor; latched")->group(kRobot)->callback([&words] {
    words.code = estop(words.context);
  });
  app.add_subcommand("stop", "end `lithe run`, like Ctrl-C")->group(kRobot)->callback([&words] {
    words.code = command(words.context, "shutdown");
  });
}

void add_motion(CLI::App& app, Words& words, const char* name, bool relative, const char* about, const char* angle) {
  CLI::App* verb = app.add_subcommand(name, about);
  verb->add_option("JOINT", words.motion.joint, "name of a joint: lithe status")->required();
  verb->add_option("DEG", words.motion.angle_deg, angle)->required();
  verb->add_option("--in", words.motion.in_s, "duration (default 2s, at most 10s)")
      ->type_name("TIME")
      ->transform(seconds());
  verb->group(kMotion)->callback([&words, relative] {
    words.motion.relative = relative;
    words.code = move(words.context, words.motion);
  });
}

void add_motions(CLI::App& app, Words& words) {
  add_plain(app, words, kMotion,
            {{"arm", "switch the drives on; the law tracks the plan"},
             {"disarm", "switch the drives off"},
             {"hold", "stop the setpoint and hold, until lithe arm"},
             {"reset", "leave a latched fault or e-stop, drives off"}});
  app.add_subcommand("recover", "bring joints inside their limits: slowly, with little torque, without a law")
      ->group(kMotion)
      ->callback([&words] { words.code = recover(words.context); });
  add_motion(app, words, "move", false, "move one joint to an angle; the others keep their setpoints",
             "target, in degrees");
  add_motion(app, words, "jog", true, "move one joint by an angle: lithe jog elbow -5", "distance, in degrees");
}

// "20ms", "2s", or a plain number of seconds.
void add_terms(CLI::App& swap, std::map<std::string, double>& terms) {
  const auto add = [&](const char* flag, const char* name, const char* type, const char* about) {
    return swap.add_option_function<double>(
                   flag, [&terms, name](double value) { terms[name] = value; }, about)
        ->type_name(type);
  };
  add("--shadow", "shadow_s", "TIME", "run it in the shadow of the active law first, for this time")
      ->transform(seconds());
  add("--tolerance", "shadow_tolerance_nm", "NM", "largest accepted torque difference in the shadow");
  add("--blend", "blend_s", "TIME", "from the old law's torque to the new one's")->transform(seconds());
  CLI::Option* probation =
      add("--probation", "probation_s", "TIME", "time in which it can be rolled back automatically")
          ->transform(seconds());
  swap.add_flag_callback(
          "--no-probation", [&terms] { terms["probation_s"] = 0; }, "no automatic rollback")
      ->excludes(probation);
  add("--error-ratio", "error_ratio", "X", "roll back when the tracking error grows by this factor; 0 = never");
  add("--budget", "budget_us", "US", "time limit of a step, in microseconds");
  add("--box", "box_ms", "MS", "processor time of the trial");
}

void add_laws(CLI::App& app, Words& words) {
  CLI::App* swap = app.add_subcommand("swap", "replace the running law");
  swap->group(kLaws);
  add_terms(*swap, words.terms);
  swap->add_option("LAW", words.law, "C++ file, or the name of a law that comes with LITHE")->required();
  swap->add_option("--param", words.params, "NAME=VALUE, tried with the law, in force on its first tick")
      ->type_name("NAME=VALUE");
  swap->callback([&words] { words.code = swap_law(words.context, words.law, words.params, words.terms); });

  CLI::App* rollback = app.add_subcommand("rollback", "back to the law before this one, with its state");
  rollback->add_option("STEPS", words.steps, "number of laws to go back, 1 to 4")->check(CLI::Range(1, 4));
  rollback->group(kLaws)->callback([&words] { words.code = cli::rollback(words.context, words.steps); });

  CLI::App* law = app.add_subcommand("law", "laws as files")->require_subcommand(1)->fallthrough();
  law->group(kLaws);
  CLI::App* check =
      law->add_subcommand("check", "compile a law, apply the admission rules, dry run; loads nothing")->fallthrough();
  check->add_option("LAW", words.law, "C++ file")->required();
  check->callback([&words] { words.code = law_check(words.context, words.law); });
  law->add_subcommand("list", "laws that come with LITHE, and laws in the Spine")->fallthrough()->callback([&words] {
    words.code = law_list(words.context);
  });
  CLI::App* show = law->add_subcommand("show", "show the certificate of a swap")->fallthrough();
  show->add_option("WHICH", words.which, "last (default), a number, or the name of a law (its newest)");
  show->callback([&words] { words.code = law_show(words.context, words.which, words.folder); });
  CLI::App* verify = law->add_subcommand("verify", "verify all certificates against their chain")->fallthrough();
  verify->callback([&words] { words.code = law_verify(words.context, words.folder); });
  for (CLI::App* each : {show, verify}) {
    each->add_option("--folder", words.folder, "folder of the certificates, instead of the robot's")->type_name("DIR");
  }

  CLI::App* param = app.add_subcommand("param", "parameters of the running law")->require_subcommand(1)->fallthrough();
  param->group(kLaws);
  CLI::App* get = param->add_subcommand("get", "values and ranges")->fallthrough();
  get->add_option("NAME", words.name, "one of them");
  get->callback([&words] { words.code = param_get(words.context, words.name); });
  CLI::App* set = param->add_subcommand("set", "change one or more")->fallthrough();
  set->add_option("PARAM", words.params, "NAME VALUE, or NAME=VALUE ...")->required();
  set->callback([&words] { words.code = param_set(words.context, words.params); });
  param->add_subcommand("revert", "the values before the last change")->fallthrough()->callback([&words] {
    words.code = param_revert(words.context);
  });
  CLI::App* save = param->add_subcommand("save", "write the present values into the law's file")->fallthrough();
  save->add_option("LAW", words.law, "C++ file of the running law")->required();
  save->callback([&words] { words.code = param_save(words.context, words.law); });
}

// The arguments that choose a bus.
void add_place(CLI::App& verb, field::Words& bus) {
  verb.add_option("WHAT", bus.what, "robot file, or a bus: fdcanusb:PATH slcan:PATH socketcan:NAME pi3hat:N")
      ->required();
  verb.add_option("--bus", bus.bus, "this bus of the robot only")->type_name("NAME");
  verb.add_option("--bitrate", bus.bitrate, "bit rate without a robot file (default 1000000)")->type_name("BIT/S");
  verb.add_option("--data-bitrate", bus.data_bitrate, "the same, of CAN FD's data; 0 = classic CAN")
      ->type_name("BIT/S");
}

void add_scan(CLI::App& bus, Words& words) {
  CLI::App* scan = bus.add_subcommand("scan", "scan the buses and compare with the robot file")->fallthrough();
  add_place(*scan, words.bus);
  scan->add_option("--listen", words.scan.listen_s, "seconds to listen before asking (default 1.1)")
      ->type_name("S")
      ->check(CLI::Range(0.0, 60.0));
  scan->callback([&words] { words.code = bus_scan(words.context, words.bus, words.scan); });
}

void add_monitor(CLI::App& bus, Words& words) {
  CLI::App* monitor = bus.add_subcommand("monitor", "show passing frames as text; then statistics")->fallthrough();
  add_place(*monitor, words.bus);
  monitor->add_flag("--raw", words.monitor.raw, "with the bytes");
  monitor->add_option("--count", words.monitor.count, "end after this many frames")->type_name("N");
  monitor->add_option("--seconds", words.monitor.seconds, "end after this time")
      ->type_name("S")
      ->check(CLI::Range(0.0, 1e9));
  monitor->add_option("--device", words.monitor.devices, "show only this device, by name or id; can be repeated")
      ->type_name("NAME")
      ->allow_extra_args(false);
  monitor->callback([&words] { words.code = bus_monitor(words.context, words.bus, words.monitor); });
}

void add_bus(CLI::App& app, Words& words) {
  CLI::App* bus = app.add_subcommand("bus", "the robot's buses")->require_subcommand(1)->fallthrough();
  bus->group(kHardware);
  CLI::App* plan = bus->add_subcommand("plan", "whether a robot's buses can carry its traffic")->fallthrough();
  plan->add_option("ROBOT", words.file, "robot file")->required();
  plan->add_option("--rate", words.plan.rate_hz, "ticks per second, instead of the file's")
      ->type_name("HZ")
      ->check(CLI::Range(1.0, 100'000.0));
  plan->add_option("--baud", words.plan.baud,
                   "of serial adapters; without it: the file's, or 921600 of a UART; USB has none")
      ->type_name("BAUD")
      ->check(CLI::Range(1'200, 100'000'000));
  plan->callback([&words] { words.code = bus_plan(words.context, words.file, words.plan); });
  add_scan(*bus, words);
  add_monitor(*bus, words);
}

void add_sim(CLI::App& app, Words& words) {
  CLI::App* sim = app.add_subcommand("sim",
                                     "simulated devices on terminals, for other programs: lithe sim --help; "
                                     "lithe sim reset: the joints of a simulated robot back to their start");
  sim->group(kHardware)->prefix_command()->set_help_flag();  // the rest of the line goes to lithe-sim
  sim->callback([&words, sim] {
    const bool reset = sim->remaining() == std::vector<std::string>{"reset"};
    words.code = reset ? command(words.context, "sim_reset") : simulate(words.context, sim->remaining());
  });
}

void add_help(CLI::App& app, Words& words) {
  CLI::App* help = app.add_subcommand("help", "this list, or the help of one verb");
  help->add_option("VERB", words.about, "one verb: lithe help law check");
  CLI::Option* before = nullptr;
  const std::pair<const char*, const char*> forms[] = {
      {"markdown", "all verbs, as docs/reference/cli.md"},
      {"man", "all verbs, as a manual page: lithe help --man | man -l -"},
      {"bash", "completion: eval \"$(lithe help --bash)\""},
      {"zsh", "completion: source <(lithe help --zsh)"}};
  for (const auto& [form, about] : forms) {
    CLI::Option* flag =
        help->add_flag_callback(std::string("--") + form, [&words, form = form] { words.form = form; }, about);
    if (before != nullptr) flag->excludes(before);
    before = flag;
  }
  help->group(kHelp)->callback([&app, &words] {
    const auto text = help_text(app, words.about, words.form);
    if (const auto* refusal = std::get_if<Refusal>(&text)) {
      words.code = refuse(words.context, *refusal);
      return;
    }
    std::cout << std::get<std::string>(text) << std::flush;
  });
}

}  // namespace

void add_words(CLI::App& app, Words& words) {
  app.name("lithe");
  app.description("LITHE: a robot whose law can be replaced while it moves");
  app.require_subcommand(1);
  app.set_version_flag("--version", version_text());
  app.add_flag("--json", words.context.json, "print one JSON document");
  app.add_option("--robot", words.context.robot, "which robot, when several run")->type_name("NAME");
  app.footer("exit code: 0 done, 1 refused, 2 usage, 3 robot fault");
  add_run(app, words);
  add_robot(app, words);
  add_motions(app, words);
  add_laws(app, words);
  add_bus(app, words);
  add_sim(app, words);
  add_help(app, words);
  for (CLI::App* each : app.get_subcommands({})) {
    each->fallthrough(each->get_name() != "sim");
  }
}

}  // namespace lithe::cli
