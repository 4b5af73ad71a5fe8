// SPDX-License-Identifier: Apache-2.0
#include "spine/core/host/paths.hpp"

#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <system_error>

namespace lithe {

std::string environment(const char* name) {
  const char* value = std::getenv(name);
  return value != nullptr ? value : "";
}

std::string program_dir() {
  std::error_code failure;
  const auto path = std::filesystem::read_symlink("/proc/self/exe", failure);
  return failure ? "." : path.parent_path().string();
}

std::string run_dir() {
  if (const std::string dir = environment("LITHE_RUN_DIR"); !dir.empty()) return dir;
  if (geteuid() == 0) return "/run/lithe";
  if (const std::string dir = environment("XDG_RUNTIME_DIR"); !dir.empty()) return dir + "/lithe";
  return "/tmp/lithe-" + std::to_string(geteuid());
}

std::string out_dir() {
  const std::string chosen = environment("LITHE_OUT_DIR");
  return chosen.empty() ? "out" : chosen;
}

std::string cache_dir() {
  if (const std::string dir = environment("LITHE_CACHE_DIR"); !dir.empty()) return dir;
  if (const std::string dir = environment("XDG_CACHE_HOME"); !dir.empty()) return dir + "/lithe";
  if (const std::string home = environment("HOME"); !home.empty()) return home + "/.cache/lithe";
  return run_dir() + "/cache";
}

std::string control_socket_path(std::string_view robot) { return run_dir() + "/" + std::string(robot) + ".sock"; }

std::string shm_path(std::string_view robot, std::string_view segment) {
  std::string prefix = environment("LITHE_SHM_PREFIX");
  if (prefix.empty()) prefix = "lithe";
  return "/dev/shm/" + prefix + "." + std::string(robot) + "." + std::string(segment);
}

}  // namespace lithe
