// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/robot.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>

#include "spine/core/host/files.hpp"
#include "spine/core/joints.hpp"
#include "spine/core/text.hpp"
#include "spine/robot/keys/sections.hpp"
#include "spine/robot/limits/limits.hpp"
#include "spine/robot/limits/model.hpp"
#include "spine/robot/read/reader.hpp"

namespace lithe::robot {
namespace {

// Reads the whole file; sections that others refer to come first.
class File {
 public:
  File(const toml::table& root, RobotConfig& robot, Report& report)
      : robot_(robot), report_(report), top_(root, "", report) {}

  void read() {
    top_.identifier("name", robot_.name);
    top_.number("rate_hz", robot_.rate_hz, {100.0, 10'000.0});
    top_.text("law", robot_.law);
    section("spine", [&](Reader& in) { read_spine(in, robot_.spine); });
    section("guard", [&](Reader& in) { read_guard(in, robot_.guard); });
    section("brain", [&](Reader& in) { read_brain(in, robot_.brain); });
    section("swap", [&](Reader& in) { read_swap(in, robot_.swap); });
    if (const toml::table* model = top_.table("model")) {
      Reader in(*model, "[model]", report_);
      read_model(in, robot_.model);
    }
    section("plant", [&](Reader& in) { read_mechanism(in, robot_.plant); });
    if (const toml::table* defaults = top_.table("defaults")) read_defaults(*defaults);
    read_buses();
    read_devices();
    if (kinds_known_) {  // else it is not known what joints and sensors may ask of their devices
      read_joints();
      read_sensors();
      if (report_.empty()) settle_model(top_, robot_);
    } else {
      top_.tables("joint");
      top_.tables("sensor", Need::optional);
    }
    read_inputs();
    top_.finish();
  }

 private:
  // An absent table is read like an empty one: its defaults hold, and are told.
  static const toml::table& or_empty(const toml::table* table) {
    static const toml::table empty;
    return table != nullptr ? *table : empty;
  }

  template <class Read>
  void section(std::string_view key, Read read) {
    Reader in(or_empty(top_.table(key)), fmt::format("[{}]", key), report_);
    read(in);
  }

  void read_defaults(const toml::table& table) {
    Reader in(table, "[defaults]", report_);
    device_defaults_ = in.table("device");
    joint_defaults_ = in.table("joint");
    in.finish();
  }

  void read_buses() {
    for (const toml::table* table : top_.tables("bus")) {
      BusConfig& bus = robot_.buses.emplace_back();
      Reader in(*table, where("bus", *table), report_);
      in.identifier("name", bus.name);
      kinds_known_ &= read_bus(in, bus, robot_.rate_hz);
      refuse_twin(in, "bus", robot_.buses);
      if (kinds_known_) check_bus(in, robot_);
    }
  }

  void read_devices() {
    const std::vector<std::string_view> buses = names(robot_.buses);
    DeviceConfig prototype;
    if (device_defaults_ != nullptr) {
      Reader in(*device_defaults_, "[defaults.device]", report_);
      if (!read_device(in, prototype, buses, Need::optional)) {
        kinds_known_ = false;
        top_.tables("device");
        return;
      }
      for (const DeviceFacts& kind : kDeviceFacts)
        read_table(in, kind.table, fmt::format("[defaults.device.{}]", kind.table.key), prototype);
      in.finish();
    }
    for (const toml::table* table : top_.tables("device")) {
      DeviceConfig& device = robot_.devices.emplace_back(prototype);
      Reader in(*table, where("device", *table), report_, device_defaults_);
      in.identifier("name", device.name);
      kinds_known_ &= read_device(in, device, buses, Need::required);
      if (!kinds_known_) continue;
      for (const DeviceFacts& kind : kDeviceFacts) {
        if (kind.table.read != nullptr && kind.kind != device.kind) in.refuse(kind.table.key, kind.table.refusal);
        read_table(in, kind.table, fmt::format("{}.{}", where("device", *table), kind.table.key), device);
      }
      if (facts(device.kind).on_bus)
        in.integer("id", device.id, {1, 126}, Need::required);
      else
        device.id = 0;
      in.finish();
      refuse_twin(in, "device", robot_.devices);
      check_neighbours(in, robot_, table->get("id") != nullptr);
      check_device(in, robot_, device);
    }
  }

  void read_table(Reader& in, const DeviceTable& own, const std::string& place, DeviceConfig& device) {
    if (own.read == nullptr) return;
    Reader inner(or_empty(in.table(own.key)), place, report_);
    own.read(inner, device.keys);
  }

  void read_sensors() {
    const std::vector<std::string_view> devices = names(robot_.devices);
    for (const toml::table* table : top_.tables("sensor", Need::optional)) {
      SensorConfig& sensor = robot_.sensors.emplace_back();
      sensor.device = devices.size();
      Reader in(*table, where("sensor", *table), report_);
      in.identifier("name", sensor.name);
      read_sensor(in, sensor, devices);
      refuse_twin(in, "sensor", robot_.sensors);
      check_sensor(in, robot_);
    }
    if (robot_.sensors.size() > kMaxSensors)
      report_.add({}, fmt::format("{} sensors, LITHE carries {}; remove some", robot_.sensors.size(), kMaxSensors));
  }

  void read_inputs() {
    for (const toml::table* table : top_.tables("input", Need::optional)) {
      InputConfig& input = robot_.inputs.emplace_back();
      Reader in(*table, where("input", *table), report_);
      in.identifier("name", input.name);
      const std::size_t mistakes = report_.count();
      in.number("min", input.min, {-kBig, kBig}, Need::required);
      in.number("max", input.max, {-kBig, kBig}, Need::required);
      input.value = std::clamp(0.0, std::min(input.min, input.max), input.max);
      in.number("value", input.value, {-kBig, kBig});
      if (report_.count() == mistakes && !(input.min <= input.value && input.value <= input.max))
        in.complain("value", fmt::format("min = {:g}, value = {:g}, max = {:g} are not in this order; correct them",
                                         input.min, input.value, input.max));
      in.finish();
      refuse_twin(in, "input", robot_.inputs);
    }
    if (robot_.inputs.size() > kMaxInputs)
      report_.add({}, fmt::format("{} inputs, LITHE carries {}; remove some", robot_.inputs.size(), kMaxInputs));
  }

  void read_joints() {
    JointConfig prototype;
    forget_limits(prototype);
    if (robot_.plant.kind == PlantKind::chain) forget_link(prototype.sim);
    if (robot_.plant.kind == PlantKind::independent) prototype.sim.inertia_kg_m2 = kUnsaid;
    const toml::table* sim_defaults = nullptr;
    if (joint_defaults_ != nullptr) {
      Reader in(*joint_defaults_, "[defaults.joint]", report_);
      read_joint(in, prototype, Need::optional);
      sim_defaults = in.table("sim");
      in.finish();
    }
    if (sim_defaults != nullptr) {
      Reader in(*sim_defaults, "[defaults.joint.sim]", report_);
      read_plant(in, prototype.sim, robot_.plant.kind);
    }
    const std::vector<const toml::table*> tables = top_.tables("joint");
    if (tables.size() > kMaxJoints) {
      report_.add(place_of(*tables[kMaxJoints]),
                  fmt::format("this is joint {} of {}, but LITHE was built for {}; remove joints or build it with "
                              "-DLITHE_NJ={}",
                              kMaxJoints + 1, tables.size(), kMaxJoints, tables.size()));
    }
    std::vector<const toml::table*> owners(robot_.devices.size(), nullptr);
    for (const toml::table* table : tables) read_one_joint(*table, prototype, owners);
    const auto& joints = robot_.joints;
    const bool one_group = std::all_of(joints.begin(), joints.end(),
                                       [&](const JointConfig& joint) { return joint.group == joints.front().group; });
    if (robot_.guard.other_groups == OtherGroups::go_on && one_group && report_.empty()) {
      robot_.notes.emplace_back(
          "[guard] other_groups = \"continue\" changes nothing: all joints are one group; give each [[joint]] a group");
    }
    for (std::size_t i = 0; i < owners.size(); ++i)
      if (owners[i] == nullptr && report_.empty() && is_drive(robot_.devices[i].kind))
        robot_.notes.push_back(fmt::format("device \"{}\" moves no joint; it is left alone", robot_.devices[i].name));
  }

  void read_one_joint(const toml::table& table, const JointConfig& prototype, std::vector<const toml::table*>& owners) {
    JointConfig& joint = robot_.joints.emplace_back(prototype);
    joint.device = owners.size();
    Reader in(table, where("joint", table), report_, joint_defaults_);
    in.identifier("name", joint.name);
    in.reference("device", joint.device, "device", names(robot_.devices));
    const std::size_t mistakes = report_.count();
    read_joint(in, joint, Need::required);
    const bool read_well = report_.count() == mistakes;  // else its limits are not what the file says
    Reader plant(or_empty(in.table("sim")), where("joint", table) + ".sim", report_);
    read_plant(plant, joint.sim, robot_.plant.kind);
    if (robot_.plant.kind == PlantKind::chain) settle_link(in, joint.sim);
    if (const toml::table* own = in.table("model")) {
      Reader model(*own, where("joint", table) + ".model", report_);
      read_joint_model(model, robot_, joint.model);
    }
    in.finish();
    refuse_twin(in, "joint", robot_.joints);
    if (joint.position_min_rad >= joint.position_max_rad && read_well) {
      in.complain("position_max_rad", fmt::format("{} is not above position_min_rad = {}; exchange or correct them",
                                                  joint.position_max_rad, joint.position_min_rad));
    }
    if (joint.device >= owners.size()) return;
    check_joint(in, robot_, joint, robot_.devices[joint.device]);
    if (const DeviceConfig& device = robot_.devices[joint.device]; !is_drive(device.kind)) {
      in.complain("device",
                  fmt::format("\"{}\" is {} and moves nothing; name a drive", device.name, facts(device.kind).noun));
    }
    if (owners[joint.device] != nullptr) {
      in.complain("device", fmt::format("\"{}\" already moves another joint (line {}); one device moves one joint",
                                        robot_.devices[joint.device].name, place_of(*owners[joint.device]).line));
    }
    owners[joint.device] = &table;
    settle_limits(in, robot_, joint);
  }

  static std::string where(std::string_view kind, const toml::table& table) {
    const auto name = table["name"].value<std::string>();
    return name ? fmt::format("[[{}]] {}", kind, *name) : fmt::format("[[{}]]", kind);
  }

  template <class T>
  static std::vector<std::string_view> names(const std::vector<T>& items) {
    std::vector<std::string_view> all;
    for (const T& item : items) all.push_back(item.name);
    return all;
  }

  // The last of `items` must not carry the name of an earlier one.
  template <class T>
  static void refuse_twin(Reader& in, std::string_view kind, const std::vector<T>& items) {
    for (std::size_t i = 0; i + 1 < items.size(); ++i) {
      if (items[i].name == items.back().name && !items[i].name.empty()) {
        in.complain("name",
                    fmt::format("there is already a [[{}]] named \"{}\"; give each its own name", kind, items[i].name));
        return;
      }
    }
  }

  RobotConfig& robot_;
  Report& report_;
  Reader top_;
  const toml::table* device_defaults_ = nullptr;
  const toml::table* joint_defaults_ = nullptr;
  bool kinds_known_ = true;  // of all buses and devices
};

// Notes about valid settings with a disadvantage; never an error.
void note_costs(RobotConfig& robot) {
  if (robot.spine.release == Release::sleep && robot.rate_hz > 2000.0) {
    robot.notes.push_back(
        fmt::format("release = \"sleep\" at {} Hz: waking takes tens of microseconds of every {:.0f}; "
                    "\"spin\" is exact",
                    robot.rate_hz, 1.0e6 / robot.rate_hz));
  }
  if (robot.plant.model.ends_with(".urdf")) {
    robot.notes.emplace_back(
        "[plant] model is a URDF: MuJoCo takes joints, masses and friction from it, and no armature, which it has not; "
        "compare inertia_max_kg_m2, or write the model as MJCF");
  }
  for (const JointConfig& joint : robot.joints) {
    if (joint.sim.initial_position_rad < joint.position_min_rad ||
        joint.sim.initial_position_rad > joint.position_max_rad) {
      robot.notes.push_back(fmt::format("joint \"{}\" starts its simulation outside its position limits", joint.name));
    }
  }
}

Place place_in(std::string_view text, std::size_t offset) {
  Place place;
  for (const char c : text.substr(0, offset)) {
    place.column = c == '\n' ? 1 : place.column + 1;
    place.line += c == '\n' ? 1 : 0;
  }
  return place;
}

}  // namespace

Result<RobotConfig> parse_robot(std::string_view text, const std::string& path) {
  Report report(path);
  if (const std::size_t bad = first_non_text(text); bad != std::string_view::npos) {
    report.add(place_in(text, bad), fmt::format("byte 0x{:02X} is no text; save the file as plain UTF-8",
                                                static_cast<unsigned char>(text[bad])));
    return report.error();
  }
  const toml::parse_result parsed = toml::parse(text, path);
  if (!parsed) {
    const auto& at = parsed.error().source().begin;
    report.add({at.line, at.column}, fmt::format("not TOML: {}", parsed.error().description()));
    return report.error();
  }
  RobotConfig robot;
  robot.path = path;
  File(parsed.table(), robot, report).read();
  if (!report.empty()) return report.error();
  robot.values = report.take_values();
  const std::filesystem::path base = std::filesystem::absolute(path).parent_path();
  for (std::string* file : {&robot.law, &robot.plant.model})
    if (!file->empty()) *file = (base / *file).lexically_normal().string();
  robot.values += "[plant]: file of the model = " + robot.plant.model + '\n';
  note_costs(robot);
  return robot;
}

Result<RobotConfig> load_robot(const std::string& path) {
  const Result<std::string> text = read_regular_file(path, kMaxConfigBytes);
  if (!text) return Error{text.message() + "; give the robot's .toml file, `ls robots/` shows the robots at hand"};
  return parse_robot(*text, path);
}

}  // namespace lithe::robot
