// SPDX-License-Identifier: Apache-2.0
#include "spine/arena/veneers.hpp"

#include <array>
#include <cmath>
#include <cstring>
#include <iterator>

namespace lithe::arena {
namespace {

constexpr std::uint64_t kFnvBasis = 0xcbf29ce484222325u, kFnvPrime = 0x100000001b3u;

// Called when a law aborts, fails an assertion or detects a damaged stack. It raises a fault, which the containment
// handles; abort() itself would raise a blocked signal, or flush files.
[[noreturn]] void trap() { __builtin_trap(); }

// The cast picks one function of the overloads a C++ library may offer under the name.
template <class Signature>
void (*address(Signature* function))() {
  return reinterpret_cast<void (*)()>(function);
}

// clang-format off
#define ONE(name) {#name, address<double(double)>(&::name)}, {#name "f", address<float(float)>(&::name##f)}
#define TWO(name) \
  {#name, address<double(double, double)>(&::name)}, {#name "f", address<float(float, float)>(&::name##f)}
#define GIVES(type, name) {#name, address<type(double)>(&::name)}, {#name "f", address<type(float)>(&::name##f)}
#define TAKES(type, name) \
  {#name, address<double(double, type)>(&::name)}, {#name "f", address<float(float, type)>(&::name##f)}

const Veneer kVeneers[] = {
    ONE(sin), ONE(cos), ONE(tan), ONE(asin), ONE(acos), ONE(atan), TWO(atan2),
    {"sincos", address<void(double, double*, double*)>(&::sincos)},  // what sin and cos of one angle become
    {"sincosf", address<void(float, float*, float*)>(&::sincosf)},
    ONE(sinh), ONE(cosh), ONE(tanh), ONE(asinh), ONE(acosh), ONE(atanh),
    ONE(exp), ONE(exp2), ONE(exp10), ONE(expm1), ONE(log), ONE(log2), ONE(log10), ONE(log1p),
    TWO(pow), ONE(sqrt), ONE(cbrt), TWO(hypot),
    ONE(floor), ONE(ceil), ONE(trunc), ONE(round), ONE(rint), ONE(nearbyint), ONE(fabs), ONE(logb),
    GIVES(long, lround), GIVES(long long, llround), GIVES(long, lrint), GIVES(long long, llrint), GIVES(int, ilogb),
    TWO(fmod), TWO(remainder), TWO(fmax), TWO(fmin), TWO(fdim), TWO(copysign), TWO(nextafter),
    {"fma", address<double(double, double, double)>(&::fma)},
    {"fmaf", address<float(float, float, float)>(&::fmaf)},
    {"remquo", address<double(double, double, int*)>(&::remquo)},
    {"remquof", address<float(float, float, int*)>(&::remquof)},
    ONE(erf), ONE(erfc), ONE(tgamma), ONE(lgamma),
    TAKES(int, ldexp), TAKES(int, scalbn), TAKES(long, scalbln), TAKES(int*, frexp),
    {"modf", address<double(double, double*)>(&::modf)},
    {"modff", address<float(float, float*)>(&::modff)},
    {"memcpy", address<void*(void*, const void*, std::size_t)>(&::memcpy)},
    {"memmove", address<void*(void*, const void*, std::size_t)>(&::memmove)},
    {"memset", address<void*(void*, int, std::size_t)>(&::memset)},
    {"memcmp", address<int(const void*, const void*, std::size_t)>(&::memcmp)},
    {"bcmp", address<int(const void*, const void*, std::size_t)>(&::memcmp)},  // what clang makes of memcmp == 0
    {"abort", &trap},
    {"__stack_chk_fail", &trap},
    {"__assert_fail", &trap},
    {"_ZSt21__glibcxx_assert_failPKciS0_S0_", &trap},  // std::__glibcxx_assert_fail
    {"_ZSt24__throw_out_of_range_fmtPKcz", &trap},     // std::array::at
    {"_ZSt20__throw_out_of_rangePKc", &trap},
    {"_ZSt20__throw_length_errorPKc", &trap},
    {"_ZSt24__throw_invalid_argumentPKc", &trap},
    {"_ZSt20__throw_domain_errorPKc", &trap},  // the special functions of <cmath>
    {"_ZSt21__throw_runtime_errorPKc", &trap},
};
#undef ONE
#undef TWO
#undef GIVES
#undef TAKES
// clang-format on
static_assert(std::size(kVeneers) * kVeneerBytes <= kGuardWord - kStubs);

std::uint64_t fnv1a(std::uint64_t hash, const void* bytes, std::size_t size) {
  const auto* at = static_cast<const unsigned char*>(bytes);
  for (std::size_t i = 0; i < size; ++i) hash = (hash ^ at[i]) * kFnvPrime;
  return hash;
}

// Jumps to the address in the second half of the stub; changes no register a call may not change.
#if defined(__x86_64__)
constexpr std::array<unsigned char, 8> kJump = {0xff, 0x25, 0x02, 0x00, 0x00, 0x00, 0x0f, 0x0b};  // jmp *[rip+2]; ud2
#elif defined(__aarch64__)
constexpr std::array<unsigned char, 8> kJump = {0x50, 0x00, 0x00, 0x58, 0x00, 0x02, 0x1f, 0xd6};  // ldr x16, #8; br x16
#else
#error "the arena knows x86-64 and AArch64"
#endif

}  // namespace

std::span<const Veneer> veneers() { return kVeneers; }

std::uint64_t veneers_hash() {
  std::uint64_t hash = kFnvBasis;
  for (const Veneer& veneer : kVeneers) hash = fnv1a(fnv1a(hash, veneer.name.data(), veneer.name.size()), "", 1);
  return hash;
}

std::uint64_t image_hash(std::span<const std::byte> image) { return fnv1a(veneers_hash(), image.data(), image.size()); }

void write_stubs(std::span<std::byte> page) {
  for (std::size_t i = 0; i < std::size(kVeneers); ++i) {
    std::byte* stub = page.data() + i * kVeneerBytes;
    std::memcpy(stub, kJump.data(), kJump.size());
    std::memcpy(stub + kJump.size(), static_cast<const void*>(&kVeneers[i].function), sizeof kVeneers[i].function);
  }
}

}  // namespace lithe::arena
