// SPDX-License-Identifier: Apache-2.0
#include "spine/core/host/realtime.hpp"

#include <malloc.h>
#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>

#include "spine/core/host/shield_group.hpp"

namespace lithe {

std::vector<int> allowed_cpus(pid_t thread) {
  cpu_set_t set;
  CPU_ZERO(&set);
  std::vector<int> cpus;
  if (sched_getaffinity(thread, sizeof set, &set) != 0) return {};
  for (int cpu = 0; cpu < CPU_SETSIZE; ++cpu)
    if (CPU_ISSET(cpu, &set)) cpus.push_back(cpu);
  return cpus;
}

int set_allowed_cpus(pid_t thread, const std::vector<int>& cores) {
  cpu_set_t set;
  CPU_ZERO(&set);
  for (const int cpu : cores)
    if (cpu >= 0 && cpu < CPU_SETSIZE) CPU_SET(static_cast<unsigned>(cpu), &set);
  return ::sched_setaffinity(thread, sizeof(set), &set) == 0 ? 0 : errno;
}

Result<> pin_this_thread(int cpu) {
  cpu_set_t set;
  CPU_ZERO(&set);
  if (cpu < 0 || cpu >= CPU_SETSIZE) return Error{"cpu " + std::to_string(cpu) + " is not a core number"};
  CPU_SET(cpu, &set);
  int error = pthread_setaffinity_np(pthread_self(), sizeof set, &set);
  // Under a shield that is a partition, only its members have its cores, and they have no others.
  if (error == EINVAL && join_group_with(cpu)) error = pthread_setaffinity_np(pthread_self(), sizeof set, &set);
  if (error == 0) return done();
  std::string allowed;
  for (const int each : allowed_cpus()) allowed += (allowed.empty() ? "" : ",") + std::to_string(each);
  return Error{"cannot pin to core " + std::to_string(cpu) + ": " + std::strerror(error) +
               "; this process may use cores " + allowed + " (set [spine] cpu_* in the robot file)"};
}

int raise_priority() {
  // In Linux a nice value belongs to a thread: PRIO_PROCESS with 0 is the caller alone.
  if (setpriority(PRIO_PROCESS, 0, -20) == 0) {
    // With autogroup scheduling a nice value counts only among the processes of one session; the session has its own.
    // Without it the file does not exist.
    if (std::FILE* session = std::fopen("/proc/self/autogroup", "w")) {
      std::fputs("-20", session);
      std::fclose(session);
    }
  }
  errno = 0;
  return getpriority(PRIO_PROCESS, 0);
}

void ordinary_priority() { setpriority(PRIO_PROCESS, 0, 0); }

void use_small_stacks() {
  pthread_attr_t attributes;
  pthread_attr_init(&attributes);
  pthread_attr_setstacksize(&attributes, std::size_t{512} << 10);
  pthread_setattr_default_np(&attributes);
  pthread_attr_destroy(&attributes);
}

void touch_stack(std::size_t bytes) {
  // volatile: the writes are the point.
  volatile auto* stack = static_cast<volatile char*>(__builtin_alloca(bytes));
  for (std::size_t at = 0; at < bytes; at += 4096) stack[at] = 0;
}

Result<> lock_memory() {
  constexpr std::size_t kStillToCome = std::size_t{16} << 20;
  // A soft limit below the hard one is the user's to raise.
  rlimit limit{};
  if (getrlimit(RLIMIT_MEMLOCK, &limit) == 0 && limit.rlim_cur < limit.rlim_max) {
    limit.rlim_cur = limit.rlim_max;
    setrlimit(RLIMIT_MEMLOCK, &limit);
  }
  // Room for more is tested by trying: the limit does not apply with CAP_IPC_LOCK.
  if (mlockall(MCL_CURRENT | MCL_FUTURE) == 0) {
    void* room = mmap(nullptr, kStillToCome, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (room != MAP_FAILED) {
      munmap(room, kStillToCome);
      return done();
    }
    errno = ENOMEM;
    munlockall();
  }
  return Error{std::string("memory is not locked (") + std::strerror(errno) +
               "): raise the memlock limit (`ulimit -l unlimited`, or LimitMEMLOCK=infinity)"};
}

void freeze_malloc() {
  mallopt(M_TRIM_THRESHOLD, -1);
  mallopt(M_MMAP_MAX, 0);
  mallopt(M_ARENA_MAX, 1);
}

}  // namespace lithe
