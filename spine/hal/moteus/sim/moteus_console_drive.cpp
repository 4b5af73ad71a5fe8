// SPDX-License-Identifier: Apache-2.0
// The console's `d` commands.
#include <limits>
#include <utility>

#include "spine/hal/bus/serial/words.hpp"
#include "spine/hal/moteus/numbers.hpp"
#include "spine/hal/moteus/sim/moteus_console.hpp"

namespace lithe::hal::sim {

using moteus::Mode;

namespace {

constexpr std::pair<char, double ServoCommand::*> kOptions[] = {{'p', &ServoCommand::kp_scale},
                                                                {'d', &ServoCommand::kd_scale},
                                                                {'i', &ServoCommand::integral_scale},
                                                                {'s', &ServoCommand::stop_position_rev},
                                                                {'f', &ServoCommand::torque_nm},
                                                                {'t', &ServoCommand::watchdog_s},
                                                                {'a', &ServoCommand::acceleration_limit_rev_s2},
                                                                {'v', &ServoCommand::velocity_limit_rev_s},
                                                                {'o', &ServoCommand::fixed_voltage_v},
                                                                {'c', &ServoCommand::fixed_current_a},
                                                                {'b', &ServoCommand::ignore_bounds}};

// The field of an option; null for an unknown letter.
double* option(ServoCommand& command, char letter) LITHE_RT {
  for (const auto& [each, field] : kOptions)
    if (each == letter) return &(command.*field);
  return nullptr;
}

bool read_options(std::string_view words, ServoCommand& command) LITHE_RT {
  for (std::string_view word = next_word(words); !word.empty(); word = next_word(words)) {
    double* target = option(command, word[0]);
    word.remove_prefix(1);
    if (target == nullptr || !read_number(word, *target)) return false;
  }
  return true;
}

Mode mode_of(std::string_view verb) LITHE_RT {
  if (verb == "pos") return Mode::position;
  if (verb == "tmt") return Mode::timeout;
  if (verb == "zero") return Mode::zero_velocity;
  if (verb == "within") return Mode::stay_within;
  return Mode::stopped;
}

}  // namespace

void MoteusConsole::drive(std::string_view words, MoteusInside& inside) LITHE_RT {
  Servo& servo = inside.servo;
  const std::string_view verb = next_word(words);
  if (verb == "stop" || verb == "brake") {
    servo.apply(verb == "stop" ? Mode::stopped : Mode::brake, ServoCommand{});
    return say("OK");
  }
  if (verb == "recapture") {
    servo.recapture();
    return say("OK");
  }
  if (verb == "req-reindex") {
    inside.servo.require_reindex();
    return say("OK");
  }
  if (verb == "dq") {
    ServoCommand command;
    if (!read_number(next_word(words), command.d_current_a) || !read_number(next_word(words), command.q_current_a))
      return say("ERR missing d/q current");
    servo.apply(Mode::current, command);
    return say("OK");
  }
  const Mode mode = mode_of(verb);
  if (mode == Mode::stopped) return set_output(verb, words, inside);
  if (drive_to(mode, words, inside)) say("OK");
}

bool MoteusConsole::drive_to(Mode mode, std::string_view words, MoteusInside& inside) LITHE_RT {
  const bool within = mode == Mode::stay_within;
  ServoCommand command;
  command.watchdog_s = std::numeric_limits<double>::quiet_NaN();  // none for console commands
  double& first = within ? command.lower_bound_rev : command.position_rev;
  double& second = within ? command.upper_bound_rev : command.velocity_rev_s;
  if (!read_number(next_word(words), first) || !read_number(next_word(words), second) ||
      !read_number(next_word(words), command.max_torque_nm)) {
    say(within ? "ERR missing min/max/t" : "ERR missing p/v/i");
    return false;
  }
  if (!read_options(words, command)) {
    say("ERR unknown option");
    return false;
  }
  inside.servo.apply(mode, command);
  return true;
}

void MoteusConsole::set_output(std::string_view verb, std::string_view words, MoteusInside& inside) LITHE_RT {
  double position_rev = 0;
  const bool given = read_number(next_word(words), position_rev);
  if (verb == "exact" || verb == "index") {
    if (!given) return say("ERR missing index value");
    inside.servo.set_output(position_rev, true);
  } else if (verb == "cfg-set-output") {
    inside.servo.set_output(given ? position_rev : 0, true);
  } else if (verb == "nearest" || verb == "rezero") {
    inside.servo.set_output(given ? position_rev : 0, false);
  } else {
    return say("ERR unknown command");
  }
  say("OK");
}

}  // namespace lithe::hal::sim
