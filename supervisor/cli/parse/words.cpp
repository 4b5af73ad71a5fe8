// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/parse/words.hpp"

#include <functional>
#include <iostream>
#include <utility>

#include "supervisor/cli/core/act.hpp"

namespace lithe::cli {
namespace {

// Headings of `lithe help`, in the order in which they are shown.
constexpr const char* kRobot = "The robot";
constexpr const char* kMotion = "Motion";
constexpr const char* kLaws = "Laws";
constexpr const char* kAgents = "Agents and learning";
constexpr const char* kHardware = "Hardware and simulation";
constexpr const char* kMachine = "This machine";
constexpr const char* kHelp = "Help";

using Act = std::function<int(CommandLine&)>;

// A verb: what it does gives the exit code.
CLI::App* add_verb(CLI::App& parent, CommandLine& words, const std::string& name, const char* about, Act act) {
  CLI::App* verb = parent.add_subcommand(name, about)->fallthrough();
  verb->callback([&words, act = std::move(act)] { words.code = act(words); });
  return verb;
}

CLI::App* add_verb(CLI::App& app, CommandLine& words, const char* group, const std::string& name, const char* about,
                   Act act) {
  return add_verb(app, words, name, about, std::move(act))->group(group);
}

CLI::App* add_group(CLI::App& app, const char* group, const char* name, const char* about) {
  return app.add_subcommand(name, about)->require_subcommand(1)->fallthrough()->group(group);
}

// An option with a value; `type`: what the help calls the value.
template <class Value>
CLI::Option* option(CLI::App& verb, const char* flag, Value& value, const char* type, const char* about) {
  return verb.add_option(flag, value, about)->type_name(type);
}

// A verb that is one command of the Spine, by another name if `command` is given.
void add_command(CLI::App& app, CommandLine& words, const char* group, const char* name, const char* about,
                 const char* command = nullptr) {
  const std::string sent = command != nullptr ? command : name;
  add_verb(app, words, group, name, about, [sent](CommandLine& w) { return cli::command(w.context, sent); });
}

void add_run(CLI::App& app, CommandLine& words) {
  CLI::App* run =
      add_verb(app, words, kRobot, "run",
               "start a robot and supervise it until Ctrl-C; adopts a Spine that already ticks", [](CommandLine& w) {
                 w.run.json = w.context.json;
                 w.run.laws = laws_dir().string();
                 return control::run_robot(w.run);
               });
  run->add_option("ROBOT", words.run.config_path, "robot file")->required();
  option(*run, "--law", words.run.law, "FILE", "law to start with, instead of the file's");
  run->add_flag_callback("--no-arm", [&words] { words.run.arm = false; }, "leave the drives off until lithe arm");
  run->add_flag("--shield", words.run.shield,
                "keep all other tasks off the Spine's core while the robot runs (needs root); undone at its end");
  run->add_flag_callback(
      "--ungated", [&words] { words.run.gates = false; }, "for tests: no admission, no dry run, no trial of laws");
}

CLI::AsNumberWithUnit seconds() {
  return CLI::AsNumberWithUnit(std::map<std::string, double>{{"s", 1.0}, {"ms", 1e-3}, {"us", 1e-6}});
}

void add_units(CLI::App& verb, Context& context) {
  option(verb, "--units", context.units, "UNITS", "of angles: deg (default) or rad")
      ->check(CLI::IsMember({"deg", "rad"}));
}

void add_robot(CLI::App& app, CommandLine& words) {
  add_verb(app, words, kRobot, "list", "running robots, with or without a supervisor",
           [](CommandLine& w) { return list(w.context); });
  CLI::App* show = add_verb(app, words, kRobot, "status", "alarms, mode, law, timing, joints",
                            [](CommandLine& w) { return status(w.context); });
  add_units(*show, words.context);
  CLI::App* live =
      add_verb(app, words, kRobot, "top", "status, live", [](CommandLine& w) { return top(w.context, w.turns); });
  option(*live, "--turns", words.turns, "N", "end after this many updates");
  add_units(*live, words.context);
  CLI::App* log = add_verb(app, words, kRobot, "events", "what happened",
                           [](CommandLine& w) { return events(w.context, w.since, w.follow); });
  option(*log, "--since", words.since, "CURSOR", "only events after this cursor");
  log->add_flag("--follow,-f", words.follow, "go on until Ctrl-C");
  CLI::App* incident =
      add_group(app, kRobot, "incident", "telemetry kept around faults, rollbacks and changes of mode");
  CLI::App* kept = add_verb(*incident, words, "list", "the newest last",
                            [](CommandLine& w) { return incident_list(w.context, w.folder); });
  CLI::App* one = add_verb(*incident, words, "show", "one of them",
                           [](CommandLine& w) { return incident_show(w.context, w.which, w.folder); });
  CLI::App* plot = add_verb(*incident, words, "plot", "draw one of them: setpoint, position and torque of each joint",
                            [](CommandLine& w) { return incident_plot(w.context, w.which, w.folder, w.file); });
  option(*plot, "--out", words.file, "FILE", "the picture, .png or .svg (default: beside the incident)");
  for (CLI::App* each : {one, plot}) each->add_option("WHICH", words.which, "last (default), or a number");
  for (CLI::App* each : {kept, one, plot})
    option(*each, "--folder", words.folder, "DIR", "folder of the incidents, instead of the robot's");
  add_verb(app, words, kRobot, "estop", "stop now, with or without a supervisor; latched",
           [](CommandLine& w) { return estop(w.context); });
  add_command(app, words, kRobot, "stop", "end `lithe run`, like Ctrl-C", "shutdown");
}

void add_motion(CLI::App& app, CommandLine& words, const char* name, bool relative, const char* about,
                const char* angle) {
  CLI::App* verb = add_verb(app, words, kMotion, name, about, [relative](CommandLine& w) {
    w.motion.relative = relative;
    return move(w.context, w.motion);
  });
  verb->add_option("JOINT", words.motion.joint, "name of a joint: lithe status")->required();
  verb->add_option("DEG", words.motion.angle_deg, angle)->required();
  option(*verb, "--in", words.motion.in_s, "TIME", "duration (default 2s, at most 10s)")->transform(seconds());
}

void add_motions(CLI::App& app, CommandLine& words) {
  add_verb(app, words, kMotion, "arm", "switch the drives on; the law tracks the plan", [](CommandLine& w) {
    return cli::command(w.context, "arm",
                        w.all_the_same ? control::Json{{"all_the_same", true}} : control::Json::object());
  })->add_flag("--all-the-same", words.all_the_same, "also with a law that has stopped the robot");
  add_verb(app, words, kMotion, "disarm", "brake to rest, then switch the drives off", [](CommandLine& w) {
    return cli::command(w.context, "disarm", {{"now", w.now}});
  })->add_flag("--now", words.now, "without braking: a moving joint coasts, or falls");
  add_command(app, words, kMotion, "hold", "stop the setpoint and hold, until lithe arm");
  add_command(app, words, kMotion, "reset", "leave a latched fault or e-stop, drives off");
  add_verb(app, words, kMotion, "recover",
           "bring joints inside their limits: slowly, with little torque, without a law",
           [](CommandLine& w) { return recover(w.context); });
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

void add_swap(CLI::App& app, CommandLine& words) {
  CLI::App* swap = add_verb(app, words, kLaws, "swap", "replace the running law",
                            [](CommandLine& w) { return swap_law(w.context, w.law, w.params, w.terms, w.no_promote); });
  add_terms(*swap, words.terms);
  swap->add_flag("--no-promote", words.no_promote, "only compare it with the running law, for the time of --shadow")
      ->needs("--shadow");
  swap->add_option("LAW", words.law, "C++ file, or the name of a law that comes with LITHE")->required();
  option(*swap, "--param", words.params, "NAME=VALUE", "NAME=VALUE, tried with the law, in force on its first tick");
  add_verb(app, words, kLaws, "rollback", "back to the law before this one, with its state",
           [](CommandLine& w) { return rollback(w.context, w.steps); })
      ->add_option("STEPS", words.steps, "number of laws to go back, 1 to 4")
      ->check(CLI::Range(1, 4));
}

void add_laws(CLI::App& app, CommandLine& words) {
  CLI::App* law = add_group(app, kLaws, "law", "laws as files");
  add_verb(*law, words, "activate", "an earlier law runs again, with its state",
           [](CommandLine& w) { return law_activate(w.context, w.which); })
      ->add_option("NAME", words.which, "as `lithe law list` has it")
      ->required();
  add_verb(*law, words, "check", "compile a law, apply the admission rules, dry run; loads nothing",
           [](CommandLine& w) { return law_check(w.context, w.law); })
      ->add_option("LAW", words.law, "C++ file")
      ->required();
  add_verb(*law, words, "list", "laws that come with LITHE, and laws in the Spine",
           [](CommandLine& w) { return law_list(w.context); });
  CLI::App* show = add_verb(*law, words, "show", "show the certificate of a swap",
                            [](CommandLine& w) { return law_show(w.context, w.which, w.folder, w.source); });
  show->add_option("WHICH", words.which, "last (default), a number, or the name of a law (its newest)");
  show->add_flag("--source", words.source, "the text of its law, as it was sent");
  CLI::App* verify = add_verb(*law, words, "verify", "verify all certificates against their chain",
                              [](CommandLine& w) { return law_verify(w.context, w.folder); });
  for (CLI::App* each : {show, verify})
    option(*each, "--folder", words.folder, "DIR", "folder of the certificates, instead of the robot's");
}

void add_params(CLI::App& app, CommandLine& words) {
  CLI::App* param = add_group(app, kLaws, "param", "parameters of the running law");
  add_verb(*param, words, "get", "values and ranges", [](CommandLine& w) {
    return param_get(w.context, w.name);
  })->add_option("NAME", words.name, "one of them");
  add_verb(*param, words, "set", "change one or more", [](CommandLine& w) { return param_set(w.context, w.params); })
      ->add_option("PARAM", words.params, "NAME VALUE, or NAME=VALUE ...")
      ->required();
  add_verb(*param, words, "revert", "the values before the last change",
           [](CommandLine& w) { return param_revert(w.context); });
  add_verb(*param, words, "save", "write the present values into the law's file",
           [](CommandLine& w) { return param_save(w.context, w.law); })
      ->add_option("LAW", words.law, "C++ file of the running law")
      ->required();
}

// The arguments that choose a bus.
void add_place(CLI::App& verb, bus::Words& bus) {
  verb.add_option("WHAT", bus.what, "robot file, or a bus: " + bus::bus_forms())->required();
  option(verb, "--bus", bus.bus, "NAME", "this bus of the robot only");
  option(verb, "--bitrate", bus.bitrate, "BIT/S", "bit rate without a robot file (default 1000000)");
  option(verb, "--data-bitrate", bus.data_bitrate, "BIT/S", "the same, of CAN FD's data; 0 = classic CAN");
}

void add_scan(CLI::App& bus, CommandLine& words) {
  CLI::App* scan = add_verb(bus, words, "scan", "scan the buses and compare with the robot file",
                            [](CommandLine& w) { return bus_scan(w.context, w.bus_words, w.scan); });
  add_place(*scan, words.bus_words);
  option(*scan, "--listen", words.scan.listen_s, "S", "seconds to listen before asking (default 1.1)")
      ->check(CLI::Range(0.0, 60.0));
}

void add_monitor(CLI::App& bus, CommandLine& words) {
  CLI::App* monitor = add_verb(bus, words, "monitor", "show passing frames as text; then statistics",
                               [](CommandLine& w) { return bus_monitor(w.context, w.bus_words, w.monitor); });
  add_place(*monitor, words.bus_words);
  monitor->add_flag("--raw", words.monitor.raw, "with the bytes");
  option(*monitor, "--count", words.monitor.count, "N", "end after this many frames");
  option(*monitor, "--seconds", words.monitor.seconds, "S", "end after this time")->check(CLI::Range(0.0, 1e9));
  option(*monitor, "--device", words.monitor.devices, "NAME", "show only this device, by name or id; can be repeated")
      ->allow_extra_args(false);
}

void add_bus(CLI::App& app, CommandLine& words) {
  CLI::App* bus = add_group(app, kHardware, "bus", "the robot's buses");
  CLI::App* plan = add_verb(*bus, words, "plan", "whether a robot's buses can carry its traffic",
                            [](CommandLine& w) { return bus_plan(w.context, w.file, w.plan); });
  plan->add_option("ROBOT", words.file, "robot file")->required();
  option(*plan, "--rate", words.plan.rate_hz, "HZ", "ticks per second, instead of the file's")
      ->check(CLI::Range(1.0, 100'000.0));
  option(*plan, "--baud", words.plan.baud, "BAUD",
         "of serial adapters; without it: the file's, or 921600 of a UART; USB has none")
      ->check(CLI::Range(1'200, 100'000'000));
  add_scan(*bus, words);
  add_monitor(*bus, words);
}

void add_sim(CLI::App& app, CommandLine& words) {
  CLI::App* sim = app.add_subcommand("sim",
                                     "simulated devices on terminals, for other programs: lithe sim --help; lithe sim "
                                     "reset: the joints of a simulated robot back to their start");
  sim->group(kHardware)->prefix_command()->set_help_flag();  // the rest of the line goes to lithe-sim
  sim->callback([&words, sim] {
    if (sim->remaining() != std::vector<std::string>{"reset"}) simulate(sim->remaining());
    words.code = command(words.context, "sim_reset");
  });
}

// Modules of the Python package; the rest of the line goes to them.
void add_modules(CLI::App& app) {
  const std::pair<const char*, const char*> modules[] = {
      {"agent", "a language model improves the law of a running robot: lithe agent --help"},
      {"mcp", "the robot as tools of the Model Context Protocol: lithe mcp --help"},
      {"evolve", "search laws and their parameters on the simulated robot: lithe evolve --help"},
      {"identify", "what recorded motion tells of a chain of links: lithe identify --help"},
      {"model", "the guard's model of the links, from a URDF or MJCF file: lithe model --help"}};
  for (const auto& [name, about] : modules) {
    CLI::App* verb = app.add_subcommand(name, about);
    verb->group(kAgents)->prefix_command()->set_help_flag();
    verb->callback([verb] { run_module("lithe." + verb->get_name(), verb->remaining()); });
  }
}

void add_doctor(CLI::App& app, CommandLine& words) {
  CLI::App* verb = add_verb(app, words, kMachine, "doctor", "how well the Spine's core is protected; changes nothing",
                            [](CommandLine& w) { return doctor(w.context, w.doctor); });
  option(*verb, "--cpu", words.doctor.cpu, "N", "judge this core, instead of the one that the Spine would get")
      ->check(CLI::Range(0, 8191));
  option(*verb, "--measure", words.doctor.measure_s, "SECONDS", "also look for gaps on the core, for so many seconds")
      ->check(CLI::Range(0.1, 600.0));
  verb->add_flag("--all", words.doctor.all, "also list what is in order");
  verb->footer("exit code: 0 tier A or B, 1 below, 2 the core cannot be judged or measured; docs/host.md");
}

void add_root(CLI::App& verb, CommandLine& words) {
  option(verb, "--root", words.tune.root, "DIR", "a mounted image instead of this machine: only its files are planned");
}

void add_target(CLI::App& verb, CommandLine& words) {
  add_root(verb, words);
  option(verb, "--cores", words.tune.cores, "LIST",
         "the robot's cores, instead of those that lithe run would take: 1,3");
  verb.add_option("ROBOT", words.tune.robot, "a robot file: its cores, and rules for the devices of its buses");
  verb.add_flag("--partition", words.tune.partition,
                "also an isolated partition of cgroup v2; then only root starts a robot on its cores");
  verb.add_flag("--no-files", words.tune.no_files, "only what ends with this boot");
}

void add_tune(CLI::App& app, CommandLine& words) {
  CLI::App* tune = add_group(app, kMachine, "tune", "set this machine up for a robot, and back");
  add_target(*add_verb(*tune, words, "plan", "show every change and its reason; changes nothing",
                       [](CommandLine& w) { return tune_plan(w.context, w.tune); }),
             words);
  add_target(*add_verb(*tune, words, "apply", "make the changes of the plan, with a journal",
                       [](CommandLine& w) { return tune_apply(w.context, w.tune); }),
             words);
  CLI::App* revert = add_verb(*tune, words, "revert", "undo them; what somebody else changed since stays",
                              [](CommandLine& w) { return tune_revert(w.context, w.tune); });
  add_root(*revert, words);
  revert->add_flag("--force", words.tune.force, "forget what somebody else changed: the journal is dropped");
  CLI::App* shield = add_verb(*tune, words, "shield", "run a command while all other tasks keep off the robot's core",
                              [](CommandLine& w) { return tune_shield(w.context, w.tune); });
  option(*shield, "--cores", words.tune.cores, "LIST", "the cores to keep free, instead of the Spine's");
  shield->add_flag(
      "--partition", words.tune.partition,
      "in an isolated partition of cgroup v2, where there is one: the command has the robot's cores alone");
  shield->add_option("COMMAND", words.tune.command, "after --: a program and its arguments")->required();
}

void add_help(CLI::App& app, CommandLine& words) {
  CLI::App* help = add_verb(app, words, kHelp, "help", "this list, or the help of one verb", [&app](CommandLine& w) {
    std::cout << value_of(help_text(app, w.about, w.form)) << std::flush;
    return 0;
  });
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
}

}  // namespace

void add_words(CLI::App& app, CommandLine& words) {
  app.name("lithe");
  app.description("LITHE: a robot whose law can be replaced while it moves");
  app.require_subcommand(1);
  app.set_version_flag("--version", version_text());
  app.add_flag("--json", words.context.json, "print one JSON document");
  option(app, "--robot", words.context.robot, "NAME", "which robot, when several run");
  app.footer("exit code: 0 done, 1 refused, 2 usage, 3 robot fault");
  add_run(app, words);
  add_robot(app, words);
  add_motions(app, words);
  add_swap(app, words);
  add_laws(app, words);
  add_params(app, words);
  add_modules(app);
  add_bus(app, words);
  add_sim(app, words);
  add_doctor(app, words);
  add_tune(app, words);
  add_help(app, words);
}

}  // namespace lithe::cli
