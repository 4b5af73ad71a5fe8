// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/plan/plan.hpp"

#include <cmath>

namespace lithe::bus {
namespace {

double rounded(double value, double per_unit) { return std::round(value * per_unit) / per_unit; }

Json rate(double hz) { return std::isfinite(hz) ? Json(rounded(hz, 10)) : Json(nullptr); }

Json frame(const Traffic& each) {
  Json out = {{"what", each.what},
              {"from", each.outbound ? "host" : "device"},
              {"bytes", each.size},
              {"extended", each.extended},
              {"fd", each.fd},
              {"average_us", rounded(each.average_us, 10)},
              {"worst_us", rounded(each.worst_us, 10)}};
  if (each.per_tick > 0)
    out["per_tick"] = each.per_tick;
  else
    out["per_s"] = each.per_s;
  return out;
}

Json frames(const std::vector<Traffic>& traffic) {
  Json out = Json::array();
  for (const Traffic& each : traffic) out.push_back(frame(each));
  return out;
}

Json device(const DevicePlan& plan, const robot::DeviceConfig& config) {
  return {{"name", config.name},
          {"kind", word(config.kind)},
          {"id", config.id},
          {"rate_divider", config.rate_divider},
          {"average_us", rounded(plan.average_us, 10)},
          {"worst_us", rounded(plan.worst_us, 10)},
          {"frames", frames(plan.traffic)}};
}

}  // namespace

Json to_json(const Plan& plan, const robot::RobotConfig& robot) {
  Json buses = Json::array();
  for (std::size_t i = 0; i < plan.buses.size(); ++i) {
    const BusPlan& bus = plan.buses[i];
    Json devices = Json::array();
    for (const DevicePlan& each : bus.devices) devices.push_back(device(each, robot.devices[each.device]));
    buses.push_back({{"name", bus.name},
                     {"kind", word(bus.kind)},
                     {"real", bus.real()},
                     {"bitrate", robot.buses[i].bitrate},
                     {"data_bitrate", robot.buses[i].data_bitrate},
                     {"load_average", rounded(bus.load_average, 1e4)},
                     {"load_worst", rounded(bus.load_worst, 1e4)},
                     {"text_load", bus.text_bytes_s > 0 ? Json(rounded(bus.text_load, 1e4)) : Json(nullptr)},
                     {"cycle_us", rounded(bus.cycle_us, 10)},
                     {"highest_rate_hz", rate(bus.highest_rate_hz)},
                     {"fits", fits(bus, plan)},
                     {"shared", frames(bus.shared)},
                     {"devices", devices}});
  }
  Json spi = Json::array();
  for (const SpiPlan& each : plan.spi) spi.push_back({{"processor", each.processor}, {"us", rounded(each.us, 10)}});
  return {{"robot", plan.robot},
          {"rate_hz", plan.rate_hz},
          {"tick_us", rounded(plan.tick_us(), 10)},
          {"fits", plan.fits},
          {"highest_rate_hz", rate(plan.highest_rate_hz)},
          {"buses", buses},
          {"spi", spi},
          {"spi_us", rounded(plan.spi_us, 10)},
          {"advice", plan.advice}};
}

}  // namespace lithe::bus
