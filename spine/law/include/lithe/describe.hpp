// SPDX-License-Identifier: Apache-2.0
// The C descriptor of a law (the one symbol its object exports), and compile-time checks with clear messages. Included
// by lithe/law.hpp; authors of laws do not need it.
#pragma once

#include "lithe/law.hpp"
#include "lithe/reflect.hpp"

namespace lithe {

// The type of a State field, as a number in the descriptor.
enum class FieldKind : std::uint32_t { none = 0, boolean, i8, u8, i16, u16, i32, u32, i64, u64, f32, f64 };

// Bytes of one element; 0 for a kind that does not exist.
constexpr std::uint32_t kind_bytes(FieldKind kind) LITHE_RT {
  constexpr std::array<std::uint32_t, 12> kBytes{0, 1, 1, 1, 2, 2, 4, 4, 8, 8, 4, 8};
  const auto i = static_cast<std::size_t>(kind);
  return i < kBytes.size() ? kBytes[i] : 0;
}

}  // namespace lithe

// The C side of a law: the one symbol its object exports. Text is zero-terminated inside its array.
extern "C" {
struct LitheStateField {
  char name[32];
  std::uint32_t kind, offset, count;  // kind: lithe::FieldKind; count: elements, 1 = scalar
};
struct LitheParam {
  char name[32];
  double value, min, max;
};
struct LitheLaw {
  std::uint32_t magic, abi;                                       // "LLAW"; kLawAbi
  std::uint32_t descriptor_size, tick_size, effort_size, joints;  // the layouts it was compiled against
  std::uint32_t state_size, state_align, state_count, param_count, probe_count, reserved;
  char name[64];
  LitheStateField state[lithe::kMaxStateFields];
  LitheParam params[lithe::kMaxParams];
  char probes[lithe::kMaxProbes][32];
  const void* state_defaults;  // state_size bytes
  // params: param_count lithe::Param in order; state: state_size bytes; probes: probe_count doubles.
  void (*step)(const lithe::Tick*, const void* params, void* state, lithe::Effort*, double* probes) LITHE_RT;
  void (*init)(const lithe::History*, const void* params, void* state) LITHE_RT;  // null: the defaults are used
};
}

namespace lithe {

inline constexpr std::uint32_t kLawMagic = 0x57414C4C;  // "LLAW"
inline constexpr std::uint32_t kLawAbi = 2;

namespace contract {

template <class T>
consteval FieldKind kind_of() {
  if constexpr (std::is_enum_v<T>) {
    return kind_of<std::underlying_type_t<T>>();
  } else if constexpr (std::is_same_v<T, bool>) {
    return FieldKind::boolean;
  } else if constexpr (std::is_integral_v<T>) {
    constexpr std::uint32_t kLog2 = sizeof(T) == 1 ? 0 : sizeof(T) == 2 ? 1 : sizeof(T) == 4 ? 2 : 3;
    return FieldKind{static_cast<std::uint32_t>(FieldKind::i8) + 2 * kLog2 + (std::is_unsigned_v<T> ? 1 : 0)};
  } else if constexpr (std::is_same_v<T, float>) {
    return FieldKind::f32;
  } else if constexpr (std::is_same_v<T, double>) {
    return FieldKind::f64;
  } else {
    return FieldKind::none;
  }
}

template <class T>
struct Element {
  using type = T;
  static constexpr std::uint32_t kCount = 0;  // no array
};
template <class T, std::size_t N>
struct Element<std::array<T, N>> {
  using type = T;
  static constexpr std::uint32_t kCount = N;
};

// A number, or an array of numbers: it is carried as a whole, by its name.
template <class T>
inline constexpr bool kIsCarried = kind_of<typename Element<T>::type>() != FieldKind::none;

template <class T>
concept PlainStruct =
    std::is_class_v<T> && std::is_aggregate_v<T> && std::is_trivially_copyable_v<T> && std::is_standard_layout_v<T>;

// Requirements on every nested struct, so that its fields can be named and copied. False stops all further checks.
enum class Role { params, state, probes };
template <Role role, class T>
consteval bool check_struct() {
  static_assert(
      PlainStruct<T> || role != Role::state,
      "LITHE: State has a field that is no plain number, or a constructor, a base class or a function that is "
      "virtual: write numbers and std::arrays of them. An Eigen matrix: std::array<double, 36> m{}; in State, "
      "and Eigen::Map<Eigen::Matrix<double, 6, 6>> m(s.m.data()); in step()");
  static_assert(PlainStruct<T> || role == Role::state,
                "LITHE: Params, State and Probes must be plain structs: public data fields only, no constructors, no "
                "base classes, no virtual functions, nothing that owns memory");
  if constexpr (!PlainStruct<T>) {
    return false;
  } else if constexpr (reflect::has_c_array<T>()) {
    static_assert(role != Role::params,
                  "LITHE: Params has an array: a Param is tuned by its own name, so write one for each: lithe::Param "
                  "kp_0_nm_rad{4, 0, 40}, kp_1_nm_rad{4, 0, 40};");
    static_assert(role == Role::params,
                  "LITHE: a State field is a C array (double x[3]): write std::array<double, 3> x{}; instead");
    return false;
  } else {
    constexpr bool kFits = reflect::field_count<T>() <= (role == Role::probes ? kMaxProbes : reflect::kMaxFields);
    static_assert(kFits || role != Role::params,
                  "LITHE: Params has more than 32 fields: what is never tuned can be a `static constexpr double` of "
                  "the law, and one Param can scale several of them");
    static_assert(kFits || role != Role::state,
                  "LITHE: State has more than 32 fields: keep numbers of one kind in a std::array<double, 8> x{}, one "
                  "quantity of all joints in a lithe::JointArray");
    static_assert(kFits || role != Role::probes, "LITHE: Probes has more than 8 fields: telemetry has room for 8");
    if constexpr (kFits) {
      static_assert(
          reflect::has_plain_layout<T>() || role != Role::state,
          "LITHE: a State field is a bit field (unsigned n : 3) or has alignas: write std::uint8_t n = 0; and "
          "no alignas");
      static_assert(reflect::has_plain_layout<T>() || role == Role::state,
                    "LITHE: alignas on a field of Params, State or Probes is not supported: remove it");
      return reflect::has_plain_layout<T>();
    }
    return kFits;
  }
}

template <class Struct, std::size_t I>
consteval void check_name() {
  static_assert(reflect::field_name<Struct, I>().size() <= kMaxNameChars,
                "LITHE: this field's name is longer than 31 characters: shorten it, but keep its unit");
}

template <class Params, std::size_t I>
consteval void check_param() {
  static_assert(
      std::is_same_v<reflect::FieldType<Params, I>, Param>,
      "LITHE: every field of Params must be a lithe::Param with its range: lithe::Param kp_nm_rad{4, 0, 40}; "
      "is {value, min, max}. Of an array each one has its own name: kp_0_nm_rad, kp_1_nm_rad. A number that is "
      "never tuned can be a `static constexpr double` of the law");
  check_name<Params, I>();
}

template <class Probes, std::size_t I>
consteval void check_probe() {
  static_assert(std::is_same_v<reflect::FieldType<Probes, I>, double>,
                "LITHE: every field of Probes must be a double: probes show up in telemetry and plots");
  check_name<Probes, I>();
}

struct NoProbes {};
template <class L>
struct ProbesOf : std::type_identity<NoProbes> {};
template <class L>
  requires requires { typename L::Probes; }
struct ProbesOf<L> : std::type_identity<typename L::Probes> {};
template <class L>
using Probes = typename ProbesOf<L>::type;

template <class L>
concept Complete = requires {
  typename L::Params;
  typename L::State;
};
template <class L>
concept Steps = requires(const Tick& t, const typename L::Params& p, typename L::State& s, Effort& u) {
  { L::step(t, p, s, u) } -> std::same_as<void>;
};
template <class L>
concept StepsWithProbes =
    requires(const Tick& t, const typename L::Params& p, typename L::State& s, Effort& u, Probes<L>& probes) {
      { L::step(t, p, s, u, probes) } -> std::same_as<void>;
    };

template <class L>
concept HasInit = requires { &L::init; };
template <class L>
concept Inits = requires(const History& past, const typename L::Params& p, typename L::State& s) {
  { L::init(past, p, s) } -> std::same_as<void>;
};

template <class L>
consteval bool check() {
  static_assert(Complete<L>,
                "LITHE: a law needs both nested structs, even when they are empty: "
                "struct Params { lithe::Param kp_nm_rad{4, 0, 40}; };  struct State {};");
  if constexpr (!Complete<L>) {
    return false;
  } else {
    static_assert(sizeof(typename L::State) <= kMaxStateBytes, "LITHE: State is larger than 4096 bytes");
    static_assert(alignof(typename L::State) <= 64, "LITHE: State asks for more than 64-byte alignment");
    static_assert(
        Steps<L> != StepsWithProbes<L>,
        "LITHE: a law has exactly one step(), static, with these arguments in this order: static void step(const "
        "lithe::Tick&, const Params&, State&, lithe::Effort&), and a fifth, Probes&, when it has a struct Probes");
    static_assert(Inits<L> || !HasInit<L>,
                  "LITHE: init must be static void init(const lithe::History&, const Params&, State&)");
    return check_struct<Role::params, typename L::Params>() && check_struct<Role::state, typename L::State>() &&
           check_struct<Role::probes, Probes<L>>() && Steps<L> != StepsWithProbes<L>;
  }
}

template <std::size_t N>
consteval void copy_text(char (&to)[N], std::string_view from) {
  for (std::size_t i = 0; i < N; ++i) to[i] = i < from.size() && i < N - 1 ? from[i] : '\0';
}

template <class L>
LITHE_LEFT_BY_A_JUMP void step(const Tick* tick, const void* params, void* state, Effort* effort, double* probes)
    LITHE_RT {
  const auto& p = *static_cast<const typename L::Params*>(params);
  auto& s = *static_cast<typename L::State*>(state);
  if constexpr (StepsWithProbes<L>) {
    Probes<L> values{};
    L::step(*tick, p, s, *effort, values);
    std::memcpy(probes, &values, sizeof(double) * reflect::field_count<Probes<L>>());
  } else {
    L::step(*tick, p, s, *effort);
  }
}

template <class L>
void init(const History* past, const void* params, void* state) LITHE_RT {
  L::init(*past, *static_cast<const typename L::Params*>(params), *static_cast<typename L::State*>(state));
}

// Names of a struct's fields are joined to its own: filter.x_rad; those of an array's elements: row[1].
struct Name {
  char text[2 * kMaxNameChars]{};
  std::size_t size = 0;

  consteval Name with(std::string_view more) const {
    Name longer = *this;
    for (const char c : more)
      if (longer.size < sizeof text) longer.text[longer.size++] = c;
    return longer;
  }
  consteval Name with(std::size_t index) const {
    const char digits[4] = {static_cast<char>('0' + index / 1000 % 10), static_cast<char>('0' + index / 100 % 10),
                            static_cast<char>('0' + index / 10 % 10), static_cast<char>('0' + index % 10)};
    const std::size_t zeros = index < 10 ? 3 : index < 100 ? 2 : index < 1000 ? 1 : 0;
    return with("[").with(std::string_view(digits + zeros, 4 - zeros)).with("]");
  }
};

// Calls to.add<T>(name, offset) for each value of T: what is carried by a name of its own.
template <class T, class To>
consteval void each_value(To& to, const Name& name = {}, std::size_t offset = 0);

template <class T, class To, std::size_t... I>
consteval void each_field([[maybe_unused]] To& to, [[maybe_unused]] const Name& name,
                          [[maybe_unused]] std::size_t offset, std::index_sequence<I...>) {
  (each_value<reflect::FieldType<T, I>>(to, (name.size == 0 ? name : name.with(".")).with(reflect::field_name<T, I>()),
                                        offset + reflect::field_offset<T, I>()),
   ...);
}

template <class T, class To>
consteval void each_value(To& to, const Name& name, std::size_t offset) {
  if constexpr (kIsCarried<T>) {
    to.template add<T>(name, offset);
  } else if constexpr (Element<T>::kCount > 0) {
    using Each = typename Element<T>::type;
    for (std::size_t i = 0; i < Element<T>::kCount; ++i) each_value<Each>(to, name.with(i), offset + i * sizeof(Each));
  } else if constexpr (!std::is_class_v<T>) {
    static_assert(std::is_class_v<T>,
                  "LITHE: a State field must be bool, an integer, an enum, float, double, a struct or a std::array of "
                  "them: a pointer cannot be carried to the next law");
  } else if constexpr (check_struct<Role::state, T>()) {
    each_field<T>(to, name, offset, std::make_index_sequence<reflect::field_count<T>()>{});
  }
}

// How many values a State has, and the characters of their longest name.
struct Extent {
  std::size_t count = 0, longest = 0;

  template <class T>
  consteval void add(const Name& name, std::size_t) {
    ++count;
    longest = name.size > longest ? name.size : longest;
  }
};
template <class State>
consteval Extent extent_of() {
  Extent seen;
  each_value<State>(seen);
  return seen;
}

struct StateWriter {
  LitheLaw& law;

  template <class T>
  consteval void add(const Name& name, std::size_t offset) {
    LitheStateField& field = law.state[law.state_count++];
    copy_text(field.name, std::string_view(name.text, name.size));
    field.kind = static_cast<std::uint32_t>(kind_of<typename Element<T>::type>());
    field.offset = static_cast<std::uint32_t>(offset);
    field.count = Element<T>::kCount == 0 ? 1 : Element<T>::kCount;
  }
};

template <class State>
consteval void describe_state(LitheLaw& law) {
  constexpr Extent kExtent = extent_of<State>();
  static_assert(
      kExtent.count <= kMaxStateFields,
      "LITHE: State has more than 32 fields, with those of its structs and the rows of its arrays: keep numbers "
      "of one kind in a std::array<double, 8> x{}, one quantity of all joints in a lithe::JointArray");
  static_assert(kExtent.longest <= kMaxNameChars,
                "LITHE: State has a field whose name, such as filter.x_rad or row[1], is longer than 31 characters: "
                "shorten it, but keep its unit");
  if constexpr (kExtent.count <= kMaxStateFields) {
    StateWriter to{law};
    each_value<State>(to);
  }
}

template <class Params, std::size_t... I>
consteval void describe_params(LitheLaw& law, std::index_sequence<I...>) {
  (check_param<Params, I>(), ...);
  [[maybe_unused]] constexpr auto kFields = reflect::field_addresses(reflect::kDefaults<Params>);
  ((copy_text(law.params[I].name, reflect::field_name<Params, I>()), law.params[I].value = std::get<I>(kFields)->value,
    law.params[I].min = std::get<I>(kFields)->min, law.params[I].max = std::get<I>(kFields)->max),
   ...);
}

template <class P, std::size_t... I>
consteval void describe_probes(LitheLaw& law, std::index_sequence<I...>) {
  (check_probe<P, I>(), ...);
  (copy_text(law.probes[I], reflect::field_name<P, I>()), ...);
}

consteval bool ranges_hold(const LitheLaw& law) {
  constexpr double kLargest = std::numeric_limits<double>::max();
  for (std::uint32_t i = 0; i < law.param_count && i < kMaxParams; ++i) {
    const LitheParam& p = law.params[i];
    if (!(-kLargest <= p.min && p.min <= p.value && p.value <= p.max && p.max <= kLargest)) return false;
  }
  return true;
}

}  // namespace contract

// The descriptor of law L. LITHE_LAW exports it; tests use it without compiling an object.
template <class L>
consteval LitheLaw describe(std::string_view name) {
  LitheLaw law{};
  if constexpr (contract::check<L>()) {
    using State = typename L::State;
    using Params = typename L::Params;
    law.magic = kLawMagic;
    law.abi = kLawAbi;
    law.descriptor_size = sizeof(LitheLaw);
    law.tick_size = sizeof(Tick);
    law.effort_size = sizeof(Effort);
    law.joints = kMaxJoints;
    law.state_size = std::is_empty_v<State> ? 0 : sizeof(State);
    law.state_align = alignof(State);
    law.param_count = reflect::field_count<Params>();
    law.probe_count = reflect::field_count<contract::Probes<L>>();
    contract::copy_text(law.name, name);
    contract::describe_state<State>(law);
    contract::describe_params<Params>(law, std::make_index_sequence<reflect::field_count<Params>()>{});
    contract::describe_probes<contract::Probes<L>>(
        law, std::make_index_sequence<reflect::field_count<contract::Probes<L>>()>{});
    law.state_defaults = &reflect::kDefaults<State>;
    law.step = &contract::step<L>;
    if constexpr (contract::Inits<L>) law.init = &contract::init<L>;
  }
  return law;
}

}  // namespace lithe
