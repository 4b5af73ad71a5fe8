// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/sim/moteus_console.hpp"

#include <limits>
#include <utility>

#include "spine/hal/bus/serial/words.hpp"

namespace lithe::hal::sim {

using moteus::Mode;

void MoteusConsole::feed(std::span<const std::uint8_t> bytes, MoteusInside& inside) LITHE_RT {
  for (const std::uint8_t byte : bytes) {
    if (byte == '\n' || byte == '\r') {
      if (!too_long_ && length_ > 0) serve({line_.data(), length_}, inside);
      length_ = 0;
      too_long_ = false;
    } else if (length_ < line_.size()) {
      line_[length_++] = static_cast<char>(byte);
    } else {
      too_long_ = true;  // not a command, so not answered
    }
  }
}

std::size_t MoteusConsole::fetch(std::span<std::uint8_t> out, const MoteusInside& inside) LITHE_RT {
  for (std::size_t i = 0; i < streams_.size(); ++i) {
    Stream& stream = streams_[i];
    if (stream.period_ns == 0 || inside.servo.time_ns() < stream.next_ns) continue;
    stream.next_ns = inside.servo.time_ns() + stream.period_ns;
    if (head_ - tail_ < kCapacity / 2) emit(i, false, inside);
  }
  std::size_t count = 0;
  while (count < out.size() && tail_ != head_) out[count++] = out_[tail_++ % kCapacity];
  return count;
}

void MoteusConsole::put(std::uint8_t byte) LITHE_RT {
  if (head_ - tail_ == kCapacity) {
    ++lost_;
    return;
  }
  out_[head_++ % kCapacity] = byte;
}

void MoteusConsole::put(std::string_view text) LITHE_RT {
  for (const char c : text) put(static_cast<std::uint8_t>(c));
}

void MoteusConsole::put_value(double value, bool integer) LITHE_RT {
  std::array<char, kLongestNumber> text{};
  put(std::string_view(text.data(), write_number(value, integer, text)));
}

void MoteusConsole::say(std::string_view text) LITHE_RT {
  put(text);
  put("\r\n");
}

void MoteusConsole::serve(std::string_view line, MoteusInside& inside) LITHE_RT {
  const std::string_view group = next_word(line);
  if (group.empty()) return;
  if (group == "tel") return tel(line, inside);
  if (group == "conf") return conf(line, inside);
  if (group == "d") return drive(line, inside);
  say("ERR unknown command");
}

void MoteusConsole::tel(std::string_view words, const MoteusInside& inside) LITHE_RT {
  const std::string_view verb = next_word(words);
  if (verb == "stop" || verb == "text") {
    for (Stream& stream : streams_) {
      if (verb == "stop") stream.period_ns = 0;
      if (verb == "text") stream.text = true;
    }
    return say("OK");
  }
  if (verb == "list") {
    for (std::size_t i = 0; i < telemetry::kChannels; ++i) say(telemetry::name(i));
    return say("OK");
  }
  if (verb != "get" && verb != "schema" && verb != "fmt" && verb != "rate") return say("ERR unknown subcommand");
  const std::size_t channel = telemetry::find(next_word(words));
  if (channel == telemetry::kNone) return say("ERR unknown name");
  if (verb == "get" || verb == "schema") return emit(channel, verb == "schema", inside);
  double value = 0;
  constexpr double kSlowest = 1e6;
  if (!read_number(next_word(words), value) || !(value >= 0 && value <= kSlowest)) return say("ERR invalid value");
  if (verb == "fmt") streams_[channel].text = value != 0;
  if (verb == "rate") streams_[channel].period_ns = static_cast<std::int64_t>(value) * 1'000'000;
  say("OK");
}

void MoteusConsole::emit(std::size_t channel, bool schema, const MoteusInside& inside) LITHE_RT {
  if (!schema && streams_[channel].text) return emit_text(channel, inside);
  std::array<std::uint8_t, telemetry::kLongestSchema> bytes{};
  const std::size_t size =
      schema ? telemetry::write_schema(channel, bytes) : telemetry::write_data(channel, inside, bytes);
  put(schema ? "schema " : "emit ");
  say(telemetry::name(channel));
  for (unsigned i = 0; i < 4; ++i) put(static_cast<std::uint8_t>(size >> (8 * i)));
  for (std::size_t i = 0; i < size; ++i) put(bytes[i]);
}

// In text mode every channel shows the state of the servo.
void MoteusConsole::emit_text(std::size_t channel, const MoteusInside& inside) LITHE_RT {
  const std::pair<std::string_view, double> values[] = {{"mode", static_cast<double>(inside.servo.mode())},
                                                        {"fault", inside.servo.fault()},
                                                        {"position", inside.servo.position_rev()},
                                                        {"velocity", inside.servo.velocity_rev_s()},
                                                        {"torque_Nm", inside.servo.torque_nm()}};
  for (const auto& [name, value] : values) {
    put(telemetry::name(channel));
    put(".");
    put(name);
    put(" ");
    put_value(value, false);
    say("");
  }
  say("OK");
}

void MoteusConsole::conf(std::string_view words, MoteusInside& inside) LITHE_RT {
  const std::string_view verb = next_word(words);
  if (verb == "enumerate") return conf_enumerate(next_word(words), inside);
  if (verb == "set") return conf_set(words, inside);
  if (verb == "get") {
    const std::string_view name = next_word(words);
    const std::size_t entry = MoteusConfig::find(name);
    std::string_view group = name;
    if (!MoteusConfig::is_group(next_field(group, '.'))) return say("ERR unknown group");
    if (entry == MoteusConfig::kNone) return say("ERR error reading");
    put_value(inside.config.value(entry), MoteusConfig::is_integer(entry));
    return say("");
  }
  if (verb == "list") {
    for (const std::string_view group : {"id", "can", "servo", "servopos", "motor", "motor_position", "uuid"})
      say(group);
    return say("OK");
  }
  if (verb == "write") inside.config.store();
  if (verb == "load") inside.config.load();
  if (verb == "default") inside.config.reset();
  if (verb != "write" && verb != "load" && verb != "default") return say("ERR unknown subcommand");
  inside.configure();
  say("OK");
}

void MoteusConsole::conf_uuid(const MoteusInside& inside) LITHE_RT {
  for (std::size_t i = 0; i < inside.identity.uuid.size(); ++i) {
    put("uuid.uuid.");
    put_value(static_cast<double>(i), true);
    put(" ");
    put_value(inside.identity.uuid[i], true);
    say("");
  }
  say("OK");
}

void MoteusConsole::conf_enumerate(std::string_view group, const MoteusInside& inside) LITHE_RT {
  if (group == "uuid") return conf_uuid(inside);
  if (!group.empty() && !MoteusConfig::is_group(group)) return say("ERR unknown group");
  for (std::size_t i = 0; i < MoteusConfig::kEntries; ++i) {
    const std::string_view name = MoteusConfig::name(i);
    std::string_view rest = name;
    if (!group.empty() && next_field(rest, '.') != group) continue;
    put(name);
    put(" ");
    put_value(inside.config.value(i), MoteusConfig::is_integer(i));
    say("");
  }
  say("OK");
}

void MoteusConsole::conf_set(std::string_view words, MoteusInside& inside) LITHE_RT {
  const std::string_view name = next_word(words);
  std::string_view group = name;
  if (!MoteusConfig::is_group(next_field(group, '.'))) return say("ERR unknown group");
  const std::size_t entry = MoteusConfig::find(name);
  double value = 0;
  if (entry == MoteusConfig::kNone || !read_number(next_word(words), value) || !inside.config.set(entry, value))
    return say("ERR error setting");
  inside.configure();
  say("OK");
}

// The `d` commands.
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
  const Mode mode = mode_of(verb);
  if (mode != Mode::stopped) return drive_to(mode, words, inside);
  if (verb == "stop" || verb == "brake") {
    servo.apply(verb == "stop" ? Mode::stopped : Mode::brake, ServoCommand{});
  } else if (verb == "recapture") {
    servo.recapture();
  } else if (verb == "req-reindex") {
    servo.require_reindex();
  } else if (verb == "dq") {
    ServoCommand command;
    if (!read_number(next_word(words), command.d_current_a) || !read_number(next_word(words), command.q_current_a))
      return say("ERR missing d/q current");
    servo.apply(Mode::current, command);
  } else {
    return set_output(verb, words, inside);
  }
  say("OK");
}

void MoteusConsole::drive_to(Mode mode, std::string_view words, MoteusInside& inside) LITHE_RT {
  const bool within = mode == Mode::stay_within;
  ServoCommand command;
  command.watchdog_s = std::numeric_limits<double>::quiet_NaN();  // none for console commands
  double& first = within ? command.lower_bound_rev : command.position_rev;
  double& second = within ? command.upper_bound_rev : command.velocity_rev_s;
  if (!read_number(next_word(words), first) || !read_number(next_word(words), second) ||
      !read_number(next_word(words), command.max_torque_nm)) {
    return say(within ? "ERR missing min/max/t" : "ERR missing p/v/i");
  }
  if (!read_options(words, command)) return say("ERR unknown option");
  inside.servo.apply(mode, command);
  say("OK");
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
