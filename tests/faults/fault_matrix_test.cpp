// SPDX-License-Identifier: Apache-2.0
// Every fault that simulated devices can show, on every kind of device, against matrix.toml; and robots without one
// rung or another, which it must refuse.
#include <gtest/gtest.h>

#include <fstream>
#include <iostream>
#include <sstream>

#include "spine/robot/read/toml.hpp"
#include "tests/faults/rig.hpp"

namespace lithe::faults {
namespace {

constexpr std::array kKinds{"moteus", "cia402", "gateway"};
constexpr const char* kAllTheWay = "safe_law brake off";

struct Wanted {
  std::string fault = "none", ladder = kAllTheWay, sensor = "valid", armed = "done", counted;
  int within = 0;
  bool others_stop = false;
};
struct Row {
  std::string name, words, kind, impossible;  // why it cannot happen
  Cell cell;
  Wanted wanted;
};

std::string text_of(const toml::node_view<const toml::node>& node, const std::string& otherwise) {
  return node.value_or(otherwise);
}

Row row_of(const std::string& name, const toml::table& fault, const std::string& kind) {
  const toml::node_view<const toml::node> cell = fault[kind];
  Row row{name, text_of(fault["words"], ""), kind, "", {}, {}};
  row.cell = {text_of(fault["order"], ""), kind, fault["before_arming"].value_or(false), false};
  if (!cell.is_table()) {
    row.impossible = text_of(cell, "MISSING");
    return row;
  }
  row.wanted.fault = text_of(cell["fault"], "none");
  row.wanted.ladder = text_of(cell["ladder"], kAllTheWay);
  row.wanted.sensor = text_of(cell["sensor"], "valid");
  row.wanted.armed = text_of(cell["armed"], "done");
  row.wanted.counted = text_of(cell["counted"], "");
  row.wanted.within = cell["within"].value_or(0);
  row.wanted.others_stop = text_of(cell["others"], "") == "stop";
  return row;
}

std::vector<Row> specification() {
  const toml::parse_result parsed = toml::parse_file(LITHE_FAULTS "/matrix.toml");
  EXPECT_TRUE(parsed) << parsed.error();
  std::vector<std::pair<std::uint32_t, std::string>> order;  // as they stand in the file
  for (const auto& [name, table] : parsed.table()) order.emplace_back(table.source().begin.line, name.str());
  std::sort(order.begin(), order.end());
  std::vector<Row> rows;
  for (const auto& [line, name] : order)
    for (const char* kind : kKinds) rows.push_back(row_of(name, *parsed.table()[name].as_table(), kind));
  return rows;
}

// Whether `is` is what is wanted, or one of several: "a or b".
bool is_one_of(const std::string& is, const std::string& wanted) {
  return (" or " + wanted + " or ").find(" or " + is + " or ") != std::string::npos;
}

bool has_word(const std::string& text, const std::string& word) {
  return (" " + text + " ").find(" " + word + " ") != std::string::npos;
}

// What is not as specified, a line each; empty when all is.
class Differences {
 public:
  explicit Differences(const Row& row) : row_(row) {}

  void expect(const std::string& what, const std::string& is, const std::string& wanted) {
    if (is_one_of(is, wanted)) return;
    text_ += row_.name + " of a " + row_.kind + ": " + what + " is '" + is + "', not '" + wanted + "'\n";
  }
  const std::string& text() const { return text_; }

 private:
  const Row& row_;
  std::string text_;
};

std::string compare(const Row& row, const Outcome& seen) {
  Differences differences(row);
  const auto expect = [&](const auto&... what) { differences.expect(what...); };
  const Wanted& wanted = row.wanted;
  expect("a broken limit", seen.broken, "");
  expect("the answer to arm", seen.armed, wanted.armed);
  expect("after reset and arm the law", seen.recovered ? "runs" : "does not run", "runs");
  if (row.cell.before_arming) return differences.text();
  const bool stops = wanted.fault != "none";
  const bool all_stop = stops && (row.cell.others_stop || wanted.others_stop);
  expect("the latched fault", seen.fault, wanted.fault);
  expect("the joint's fault", seen.joint_fault, wanted.fault);
  expect("the joint's ladder", seen.ladder, stops ? wanted.ladder : "law");
  expect("its group's ladder", seen.group, stops ? wanted.ladder : "law");
  expect("the others' ladder", seen.others, all_stop ? kAllTheWay : "law");
  // With everybody's fault the event may name another joint, which was the first.
  const std::string at =
      seen.joint_fault + " at joint " + (row.kind == "cia402" ? "c1, group right" : "m1, group left");
  if (!wanted.others_stop) expect("the event's text", seen.named, stops ? at : "");
  expect("what is latched", seen.latched ? "kept" : "undone", "kept");
  expect("the sensor", seen.sensor, wanted.sensor);
  expect("in time", seen.ticks <= wanted.within ? "yes" : "after " + std::to_string(seen.ticks) + " ticks", "yes");
  std::istringstream words(wanted.counted);
  for (std::string word; words >> word;) expect("counted", has_word(seen.counted, word) ? word : seen.counted, word);
  return differences.text();
}

std::string line_of(const Row& row, const Outcome& go_on, const Outcome& stop) {
  const auto cell = [](const std::string& text) { return " " + (text.empty() ? "-" : text) + " |"; };
  std::string line = "|" + cell(row.name) + cell(row.kind);
  if (!row.impossible.empty()) return line + " - | " + row.impossible + " | | | | |";
  if (row.cell.before_arming) return line + cell("arm: " + go_on.armed) + " - | | | | |";
  std::string counted = go_on.counted;
  if (go_on.sensor == "lost") counted += (counted.empty() ? "" : ", ") + std::string("sensor NaN");
  if (row.wanted.fault.find(" or ") != std::string::npos) {  // chance is not for a page
    return line +
           cell("one of " + std::to_string(1 + std::count(row.wanted.fault.begin(), row.wanted.fault.end(), ' ') / 2)) +
           " safe_law ... | <= " + std::to_string(row.wanted.within) + " |" + cell(go_on.others) + " safe_law ... | " +
           row.wanted.counted + " |";
  }
  return line + cell(go_on.fault) + cell(go_on.ladder) + cell(go_on.ticks > 0 ? std::to_string(go_on.ticks) : "") +
         cell(go_on.others) + cell(stop.others) + cell(counted);
}

struct Matrix {
  std::string wrong;
  std::string table =
      "| fault | device | latched | ladder | ticks | others, `continue` | others, `stop` | counted |\n"
      "|---|---|---|---|---|---|---|---|\n";
};

Matrix run_all() {
  Matrix matrix;
  for (Row row : specification()) {
    Outcome go_on, stop;
    if (row.impossible.empty()) {
      go_on = run(row.cell);
      matrix.wrong += compare(row, go_on);
      row.cell.others_stop = true;
      stop = run(row.cell);
      matrix.wrong += compare(row, stop);
    }
    matrix.table += line_of(row, go_on, stop) + "\n";
  }
  return matrix;
}

TEST(FaultMatrix, EveryFaultOfEveryDeviceEndsOnItsRungAndTheTableInTheDocsSaysSo) {
  const Matrix matrix = run_all();
  std::cout << matrix.table;
  EXPECT_EQ(matrix.wrong, "");
  std::ifstream page(LITHE_FAULTS "/../../docs/reference/faults.md");
  std::stringstream text;
  text << page.rdbuf();
  EXPECT_NE(text.str().find(matrix.table), std::string::npos)
      << "docs/reference/faults.md shows another table; put this one there:\n"
      << matrix.table;
}

// Drives that are asked in every Nth tick are found out N times later, and come back all the same.
TEST(FaultMatrix, DrivesThatAreSeldomAskedEndOnTheSameRungs) {
  const std::pair<int, void (*)(robot::RobotConfig&)> dividers[] = {{4,
                                                                     [](robot::RobotConfig& r) {
                                                                       for (auto& d : r.devices) d.rate_divider = 4;
                                                                     }},
                                                                    {16, [](robot::RobotConfig& r) {
                                                                       for (auto& d : r.devices) d.rate_divider = 16;
                                                                     }}};
  std::string wrong;
  for (Row row : specification()) {
    constexpr std::array kThese{"drop",         "bus_off",          "reset", "watchdog",
                                "device_fault", "over_temperature", "twin",  "wrong_id"};
    if (row.kind == "gateway" || std::find(kThese.begin(), kThese.end(), row.name) == kThese.end()) continue;
    const int within = row.wanted.within;
    for (const auto& [divider, change] : dividers) {
      row.wanted.within = within * divider;
      if (const std::string found = compare(row, run(row.cell, change)); !found.empty())
        wrong += "asked in every " + std::to_string(divider) + "th tick: " + found;
    }
  }
  EXPECT_EQ(wrong, "");
}

TEST(FaultMatrix, SameFaultSameOutcome) {
  const Cell cell{R"({"fault": "corrupt", "share": 1})", "moteus"};
  const Outcome a = run(cell), b = run(cell);
  EXPECT_EQ(a.fault, b.fault);
  EXPECT_EQ(a.ticks, b.ticks);
  EXPECT_EQ(a.counted, b.counted);
}

// Robots that lack what the specification wants. The matrix must refuse each, in the words that tell why.
struct Lacking {
  const char* fault;
  const char* kind;
  void (*change)(robot::RobotConfig&);
  const char* told;
};
const Lacking kLacking[] = {
    {"device_fault", "moteus", [](robot::RobotConfig& r) { r.guard.brake_after_s = 0; },
     "the joint's ladder is 'safe_law off'"},
    {"device_fault", "cia402", [](robot::RobotConfig& r) { r.guard.off_after_s = 0; },
     "the joint's ladder is 'safe_law brake'"},
    {"drop", "moteus", [](robot::RobotConfig& r) { r.guard.lost_after_misses = 100'000; },
     "the joint's ladder is 'law'"},
    {"drop", "cia402", [](robot::RobotConfig& r) { r.guard.lost_after_misses = 50; }, "in time is 'after"},
    {"watchdog", "moteus",
     [](robot::RobotConfig& r) {
       for (auto& j : r.joints) j.group = "";
     },
     "the others' ladder"},
    {"encoder", "moteus", [](robot::RobotConfig& r) { r.joints[1].group = "alone"; }, "its group's ladder is 'law'"},
    {"unhomed_at_start", "moteus", [](robot::RobotConfig& r) { r.joints[0].must_be_homed = false; },
     "the answer to arm is 'done'"},
    {"drop", "gateway", [](robot::RobotConfig& r) { r.devices[5].watchdog_s = 10; }, "the sensor is 'valid'"},
};

TEST(FaultMatrix, ARobotWithoutARungIsRefused) {
  const std::vector<Row> rows = specification();
  for (const Lacking& lacking : kLacking) {
    const auto row = std::find_if(rows.begin(), rows.end(), [&](const Row& each) {
      return each.name == lacking.fault && each.kind == lacking.kind;
    });
    ASSERT_NE(row, rows.end()) << lacking.fault;
    const std::string wrong = compare(*row, run(row->cell, lacking.change));
    EXPECT_NE(wrong.find(lacking.told), std::string::npos) << lacking.fault << ": '" << wrong << "'";
  }
}

// The comparison itself: each of its lines can be wrong.
TEST(FaultMatrix, AnOutcomeThatIsOtherwiseInAnythingIsRefused) {
  Row row{"drop", "", "moteus", "", {R"({"fault": "drop", "share": 1})", "moteus"}, {}};
  row.wanted.fault = "drive_lost";
  row.wanted.ladder = "safe_law brake";
  row.wanted.within = 9;
  row.wanted.counted = "missed";
  const Outcome good = run(row.cell);
  ASSERT_EQ(compare(row, good), "");
  std::vector<Outcome> bad(11, good);
  bad[0].fault = "drive_fault";
  bad[1].joint_fault = "none";
  bad[2].ladder = "safe_law";
  bad[3].group = "law";
  bad[4].others = kAllTheWay;
  bad[5].named.clear();
  bad[6].latched = false;
  bad[7].recovered = false;
  bad[8].broken = "slew of m1";
  bad[9].ticks = 10;
  bad[10].counted = "late";
  for (std::size_t i = 0; i < bad.size(); ++i) EXPECT_NE(compare(row, bad[i]), "") << i;
}

}  // namespace
}  // namespace lithe::faults
