// SPDX-License-Identifier: Apache-2.0
#include "lawd/source/admission_words.hpp"

#include <algorithm>
#include <array>
#include <utility>

#include "spine/arena/veneers.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::lawd {
namespace {

constexpr std::string_view kHeaders =
    " <lithe/law.hpp> <cmath> <array> <algorithm> <span> <numbers> <type_traits> <cstddef> <cstdint> <limits> ";

constexpr std::string_view kKeywords =
    " alignas alignof auto bool break case char char16_t char32_t char8_t class concept const const_cast consteval "
    "constexpr constinit continue decltype default delete do double dynamic_cast else enum explicit export extern "
    "false final float for friend goto if inline int long mutable namespace new noexcept nullptr operator "
    "override private protected public register reinterpret_cast requires return short signed sizeof static "
    "static_assert static_cast struct switch template this thread_local throw true try typedef typeid typename "
    "union unsigned using virtual void volatile wchar_t while asm and or ";

constexpr std::string_view kHarmlessReserved =
    " __x86_64__ __aarch64__ __restrict __restrict__ __cplusplus __LINE__ __FILE__ __func__ __COUNTER__ "
    "__builtin_expect __GNUC__ ";

// Whether a list of words has this one; a list has blanks between its words and around them.
bool has(std::string_view list, std::string_view word) {
  return !has_text(word, " ") && has_text(list, " " + std::string(word) + " ");
}

struct Word {
  std::string_view word, why;
};

// Several of one reason.
struct Group {
  std::string_view why, names;
};
constexpr std::string_view kNoHeap =
    "a law allocates nothing: use a std::array of fixed size (no #include needed), in State if it must outlive the "
    "step";
// In an object: a law's text with these names was refused before. So it comes from Eigen.
constexpr std::string_view kNoHeapForEigen =
    "a law allocates nothing: use an Eigen matrix of fixed size, such as Eigen::Matrix<double, 6, 6>, not MatrixXd; a "
    "function of Eigen that takes memory for fixed sizes, too, is not for laws (docs/laws.md)";
constexpr std::string_view kNoPrint =
    "a law prints nothing: leave it out, or show a number in telemetry by a probe: struct Probes { double x = 0; }; "
    "beside Params, a fifth argument Probes& probes of step(), and in it probes.x = ...;";
constexpr std::string_view kNoThread = "a law has one thread and never waits: what takes long belongs in the Brain";
constexpr std::string_view kNoClock = "a law never waits and reads no clock: time is in t.t_s and t.dt_s";
constexpr std::string_view kNoFile =
    "a law opens no file and no socket: what it needs belongs in Params or comes through the setpoint";
constexpr std::string_view kNoChance =
    "the same input must give the same output: leave it out, or keep a generator's state in State (std::uint32_t "
    "seed = 1;) and compute it in step(): s.seed = s.seed * 1664525u + 1013904223u; then s.seed / 4294967296.0 is from "
    "0 to 1";
constexpr std::string_view kNoEnd = "a law may not end, copy or signal its process: to stop, return zero torque";
constexpr std::string_view kNoThrow = "a law has no exceptions: test the value, set a safe torque and return";
constexpr std::string_view kNoCast = "a law works on numbers and never on raw memory: keep the type, or copy the value";
constexpr std::string_view kNoCoroutine = "coroutines allocate: keep what must be remembered in State";
constexpr std::array kWords = std::to_array<Group>({
    {"inline assembly cannot be checked: write it in C++", " asm __asm__ __asm "},
    {"a law declares nothing from outside itself: <cmath> and the contract are all it may call", " extern "},
    {kNoHeap, " new delete "},
    {kNoThrow, " throw try catch "},
    {"a law has no memory but its State: move the variable there", " thread_local __thread "},
    {"virtual functions are calls through memory: use a template, an if or a switch", " virtual "},
    {"there is no run-time type information in a law", " dynamic_cast typeid "},
    {kNoCast, " reinterpret_cast "},
    {"the inputs are not a law's to change: copy what you need", " const_cast "},
    {kNoCoroutine, " co_await co_yield co_return "},
    {"a law is one file, not a module", " export "},
    {"it changes how the law is compiled or checked: remove it", " _Pragma "},
    {"attributes in this form are not for laws: remove it, or use a standard [[attribute]]",
     " __attribute__ __attribute "},
    {"a law compiles to the same code everywhere: it may not ask what is on the disk",
     " __has_include __has_include_next "},
    {"the same law must give the same object each time: write the text itself", " __DATE__ __TIME__ __TIMESTAMP__ "},
});

// Of the standard library, outside the headers that a law may include.
constexpr std::array kStdNames = std::to_array<Group>({
    {kNoHeap,
     " vector string map unordered_map set unordered_set list deque queue function unique_ptr shared_ptr "
     "make_unique make_shared multimap stack valarray to_string stringstream any "},
    {kNoPrint, " cout cerr printf print println endl clog format "},
    {kNoThread, " thread mutex async jthread this_thread lock_guard atomic future "},
    {kNoClock, " chrono "},
    {kNoFile, " ifstream ofstream fstream "},
    {kNoThrow, " exception runtime_error "},
    {kNoChance,
     " mt19937 random_device default_random_engine uniform_real_distribution normal_distribution rand srand "},
});
// Functions by their bare names.
constexpr std::array kCalls = std::to_array<Group>({
    {kNoPrint, " printf fprintf puts snprintf sprintf "},
    {kNoHeap, " malloc calloc realloc free "},
    {kNoChance, " rand srand "},
    {kNoFile, " fopen "},
    {kNoClock, " sleep usleep nanosleep clock_gettime gettimeofday "},
    {kNoEnd, " exit abort assert "},
});
constexpr std::array kRefusedHeaders = std::to_array<Group>({
    {kNoHeap, " <vector> <string> <map> <unordered_map> <set> <list> <deque> <queue> <memory> "},
    {"call the function itself, or a lambda: std::function allocates", " <functional> "},
    {kNoPrint, " <iostream> <cstdio> <stdio.h> <sstream> <iomanip> <format> "},
    {kNoFile, " <fstream> <filesystem> "},
    {kNoThread, " <thread> <mutex> <atomic> <future> <condition_variable> "},
    {kNoClock, " <chrono> <ctime> <time.h> "},
    {kNoChance, " <random> "},
    {"std::abs, std::fabs and the rest of mathematics are in <cmath>", " <cstdlib> <stdlib.h> "},
    {"write <cmath>", " <math.h> "},
    {"write <cstdint>", " <stdint.h> "},
    {kNoEnd, " <cassert> "},
    {kNoThrow, " <stdexcept> <exception> "},
    {"assign structs and arrays, without memcpy", " <cstring> "},
    {"<algorithm> brings std::swap, std::pair and std::move", " <utility> "},
    {"use a bool field beside the value", " <optional> "},
    {"write <Eigen/Dense>", " <eigen3/Eigen/Dense> "},
});

constexpr std::string_view kAttributes =
    " likely unlikely maybe_unused nodiscard fallthrough deprecated no_unique_address noreturn carries_dependency ";
constexpr std::string_view kGnuAttributes = " always_inline noinline flatten hot cold pure const ";

// Prefix of a name, and what to use instead. The first match counts.
constexpr std::array kWordAdvice = std::to_array<Word>({
    {"operator new", kNoHeap},
    {"operator delete", kNoHeap},
    {"std::__throw",
     "it throws, as .at() does, and a law has no exceptions: use [], with an index below t.joints or the length"},
    {"std::terminate", kNoThrow},
    {"__cxa_guard", "a static variable inside a function: move it to State"},
    {"__cxa_atexit", "an object with a destructor at namespace scope: keep plain values in State"},
    {"__cxa_pure", "virtual functions are calls through memory: use a template, an if or a switch"},
    {"vtable for", "virtual functions are calls through memory: use a template, an if or a switch"},
    {"__cxa", kNoThrow},
    {"_Unwind", kNoThrow},
    {"__gxx", kNoThrow},
    {"typeinfo", "there is no run-time type information in a law"},
    {"__tls", "a law has no memory but its State"},
    {"std::cout", kNoPrint},
    {"std::basic_ostream", kNoPrint},
    {"std::ostream", kNoPrint},
    {"std::ios_base", kNoPrint},
    {"std::chrono", kNoClock},
    {"std::thread", "a law starts no thread: what takes long belongs in the Brain"},
});

constexpr std::string_view kOnlyTrap =
    " abort __assert_fail _ZSt24__throw_out_of_range_fmtPKcz _ZSt20__throw_out_of_rangePKc "
    "_ZSt20__throw_length_errorPKc _ZSt24__throw_invalid_argumentPKc _ZSt20__throw_domain_errorPKc "
    "_ZSt21__throw_runtime_errorPKc lgamma lgammaf ";

constexpr std::array kGroups = std::to_array<Group>({
    {kNoHeapForEigen,
     " malloc calloc realloc free aligned_alloc posix_memalign strdup mmap munmap brk sbrk reallocarray "
     "mprotect madvise mremap "},
    {kNoPrint,
     " printf fprintf puts putchar fputs fwrite write snprintf sprintf perror fputc fflush vprintf dprintf "
     "stdout stderr "},
    {kNoFile,
     " open fopen close fclose read fread socket connect send recv ioctl openat poll select getenv fgets sendto "
     "shm_open fcntl dlopen dlsym "},
    {kNoClock,
     " sleep usleep nanosleep clock_gettime clock_nanosleep gettimeofday time clock sched_yield pause localtime "
     "gmtime times "},
    {kNoEnd,
     " exit _exit _Exit abort quick_exit atexit fork vfork execve execl system kill raise signal sigaction "
     "setjmp _setjmp longjmp __sigsetjmp siglongjmp waitpid popen "},
    {kNoThread,
     " pthread_create pthread_mutex_lock pthread_mutex_unlock sem_wait pthread_cond_wait pthread_exit "
     "pthread_self pthread_kill pthread_mutex_trylock pthread_join pthread_once "},
    {kNoChance, " rand srand random drand48 rand_r getrandom getentropy arc4random srandom "},
    {"it makes system calls, which the tick may not: leave it out", " syscall prctl setitimer timer_create "},
    {"it also writes a global variable (signgam): for 0 < x < 171 write std::log(std::tgamma(x))",
     " lgamma lgammaf signgam "},
    {"std::errno is a global: test the argument before the call", " __errno_location "},
});

template <std::size_t N>
std::string_view why_listed(const std::array<Group, N>& list, std::string_view word) {
  const auto found = std::ranges::find_if(list, [word](const Group& each) { return has(each.names, word); });
  return found == list.end() ? "" : found->why;
}

}  // namespace

bool is_allowed_header(std::string_view header) {
  const bool eigen = header.starts_with("<Eigen/") && header.find("..") == std::string_view::npos;
  return has(kHeaders, header) || eigen;
}

std::string allowed_headers_text() { return std::string(kHeaders.substr(1)) + "and <Eigen/...>"; }

bool is_keyword(std::string_view word) { return has(kKeywords, word); }

bool is_reserved(std::string_view word) {
  const bool reserved =
      word.starts_with("__") || (word.size() > 1 && word[0] == '_' && word[1] >= 'A' && word[1] <= 'Z');
  return reserved && !has(kHarmlessReserved, word);
}

std::string_view why_word_is_refused(std::string_view word) { return why_listed(kWords, word); }

std::string_view why_std_name_is_refused(std::string_view name) { return why_listed(kStdNames, name); }

std::string_view why_call_is_refused(std::string_view name) { return why_listed(kCalls, name); }

std::string_view why_header_is_refused(std::string_view header) { return why_listed(kRefusedHeaders, header); }

bool is_allowed_attribute(std::string_view name, bool in_namespace) {
  return has(in_namespace ? kGnuAttributes : kAttributes, name);
}

// The arena has more stubs than this list; a law that was not admitted and calls one of the others traps.
bool is_allowed_symbol(std::string_view symbol) {
  if (symbol == "_GLOBAL_OFFSET_TABLE_") return true;  // the linker's own
  if (has(kOnlyTrap, symbol)) return false;
  const auto veneers = arena::veneers();
  return std::ranges::any_of(veneers, [&](const arena::Veneer& veneer) { return veneer.name == symbol; });
}

std::string why_symbol_is_refused(std::string_view symbol, std::string_view readable) {
  const std::string_view bare = readable.substr(0, readable.find('('));
  for (const Group& group : kGroups)
    if (has(group.names, bare) || has(group.names, symbol)) return std::string(group.why);
  for (const Word& entry : kWordAdvice)
    if (readable.starts_with(entry.word)) return std::string(entry.why);
  if (symbol.ends_with("l") && is_allowed_symbol(symbol.substr(0, symbol.size() - 1)))
    return "long double is not the same on every machine: use double";
  return "a law may use itself, the contract and <cmath> only: compute it in the law";
}

}  // namespace lithe::lawd
