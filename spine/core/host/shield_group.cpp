// SPDX-License-Identifier: Apache-2.0
#include "spine/core/host/shield_group.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <sstream>

#include "spine/core/host/cores.hpp"
#include "spine/core/host/fd.hpp"
#include "spine/core/host/files.hpp"

namespace lithe {
namespace {

constexpr std::size_t kMostGroupBytes = std::size_t{64} << 10;

bool write_word(const std::string& path, const std::string& word) {
  const Fd file(::open(path.c_str(), O_WRONLY | O_CLOEXEC));
  return file && ::write(file.get(), word.data(), word.size()) == static_cast<ssize_t>(word.size());
}

// Whether threads of another process are in it: of another robot.
bool is_taken(const std::string& root) {
  const Result<std::string> tids = read_regular_file(root + kShieldGroup + "/cgroup.threads", kMostGroupBytes);
  std::istringstream lines(tids ? *tids : "");
  for (std::string tid; lines >> tid;)
    if (::access((root + "/proc/self/task/" + tid).c_str(), F_OK) != 0) return true;
  return false;
}

std::vector<int> open_cores(const std::string& root) {
  const std::string group = root + kShieldGroup;
  // A thread comes from another group by way of the root: the kernel asks for the right to write there, too.
  const bool allowed = ::access((group + "/cgroup.threads").c_str(), W_OK) == 0 &&
                       ::access((root + kGroupsRoot + "/cgroup.procs").c_str(), W_OK) == 0;
  if (!allowed || first_line(group + "/cpuset.cpus.partition") != "isolated") return {};
  return parse_cpu_list(first_line(group + "/cpuset.cpus.effective"));
}

}  // namespace

std::string first_line(const std::string& path) {
  const Result<std::string> text = read_regular_file(path, kMostGroupBytes);
  return text ? text->substr(0, text->find('\n')) : "";
}

std::string group_of(const std::string& who, const std::string& root) {
  const Result<std::string> lines = read_regular_file(root + "/proc/" + who + "/cgroup", kMostGroupBytes);
  const std::string text = lines ? "\n" + *lines : "";
  const std::size_t at = text.find("\n0::/");
  return at == std::string::npos ? "" : text.substr(at + 4, text.find('\n', at + 1) - at - 4);
}

std::vector<int> shield_cores(const std::string& root) {
  return is_taken(root) ? std::vector<int>() : open_cores(root);
}

bool join_group_with(int cpu, const std::string& root) {
  const std::vector<int> shielded = open_cores(root);
  if (shielded.empty()) return false;
  const std::string shield = std::string(kShieldGroup).substr(std::string(kGroupsRoot).size());
  const bool wanted = std::binary_search(shielded.begin(), shielded.end(), cpu),
             inside = group_of("thread-self", root) == shield;
  if (wanted == inside) return false;
  const std::string tid = std::to_string(::gettid());
  if (!wanted) return write_word(root + kGroupsRoot + "/cgroup.threads", tid);
  // Threads of one process share a domain: all of them go to the root's, and this one on from there.
  if (group_of("thread-self", root) != "/" &&
      !write_word(root + kGroupsRoot + "/cgroup.procs", std::to_string(::getpid())))
    return false;
  return write_word(root + kShieldGroup + "/cgroup.threads", tid);
}

}  // namespace lithe
