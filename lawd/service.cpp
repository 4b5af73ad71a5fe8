// SPDX-License-Identifier: Apache-2.0
#include "lawd/service.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <variant>

#include "lawd/compile/diagnostics.hpp"
#include "lawd/core/admission.hpp"
#include "lawd/object/admission_lines.hpp"
#include "lawd/run/dry_run.hpp"
#include "lawd/run/files.hpp"
#include "lawd/source/clean.hpp"
#include "lawd/source/help.hpp"
#include "spine/core/host/files.hpp"
#include "spine/core/joints.hpp"
#include "spine/core/sha256.hpp"

namespace lithe::lawd {
namespace {

using nlohmann::json;
constexpr std::size_t kMaxJobSourceBytes = std::size_t{1} << 20;
constexpr std::uintmax_t kMostCacheBytes = std::uintmax_t{256} << 20;  // about 3,500 laws
constexpr unsigned kStoresBetweenTidying = 100;
constexpr std::size_t kMaxLinks = 64;  // two laws in every slot, and a reserve

// The hash of a law in the cache; empty when it is not a valid hash.
std::string hash_in(const json& request) {
  const json hash = request.value("hash", json());
  const std::string text = hash.is_string() ? hash.get<std::string>() : "";
  return text.size() == 64 && text.find_first_not_of("0123456789abcdef") == std::string::npos ? text : "";
}

// A boolean of a request, with `wanted` as default.
bool is_on(const json& request, const char* key, bool wanted) {
  const auto found = request.find(key);
  return found != request.end() && found->is_boolean() ? found->get<bool>() : wanted;
}

// The time budget depends on the robot, so it is checked per request and not cached. Null when the law fits, no budget
// was given, or there is no entry.
json over_budget(const json& entry, const std::string& name, const json& budget_ns) {
  if (budget_ns.is_null() || !entry.is_object() || !entry.value("ok", false)) return nullptr;
  const double step_ns = entry["dry_step_max_ns"], budget = budget_ns;
  if (step_ns <= budget) return nullptr;
  return refuse_whole(
      "dry_run", name,
      fmt::format(
          "a step takes up to {:.1f} us here and the robot leaves it {:.1f} us: do less in step(), or less often",
          step_ns * 1e-3, budget * 1e-3));
}

// A safe file name: letters, digits, dot, dash, underscore; ends in .cpp.
std::string safe_name(const std::string& wanted) {
  std::string name;
  for (const char c : wanted.substr(wanted.find_last_of('/') + 1)) {
    const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9');
    name += plain || c == '_' || c == '-' || (c == '.' && !name.empty()) ? c : '_';
  }
  if (name.size() > 100) name = name.substr(name.size() - 100);
  if (name.empty()) name = "law";
  if (!name.ends_with(".cpp")) name += ".cpp";
  return name;
}

// Duration of each step of a build.
class Laps {
 public:
  void lap(const char* step) {
    ms_[step] = since_ms(from_);
    from_ = std::chrono::steady_clock::now();
  }
  const json& ms() const { return ms_; }

 private:
  json ms_ = json::object();
  std::chrono::steady_clock::time_point from_ = std::chrono::steady_clock::now();
};

}  // namespace

Service::Service(std::string cache, int arena_fd, const Limits& compiler)
    : cache_(std::move(cache)), compiler_(compiler), toolchain_(find_contract_dir(), cache_) {
  Result<arena::Writer> writer = arena::Writer::attach(arena_fd);
  if (writer)
    arena_.emplace(std::move(*writer));
  else
    arena_error_ = writer.message();
  if (arena::is_memory(arena_fd)) close(arena_fd);
  sweep_scratch(cache_ + "/laws");
}

json Service::answer(const std::string& line) {
  const json request = json::parse(line, nullptr, false);
  json reply;
  if (!request.is_object() || !request.contains("verb") || !request["verb"].is_string()) {
    reply = refuse("request", "not a request: send one JSON object per line with \"id\" and \"verb\"");
  } else if (request["verb"] == "ping") {
    reply = {{"ok", toolchain_.error().empty()},
             {"text", toolchain_.error()},
             {"precompiled", toolchain_.precompiled()},
             {"precompile_ms", toolchain_.precompile_ms()},
             {"arena", arena_.has_value()},
             {"arena_text", arena_error_}};
  } else if (request["verb"] == "compile") {
    reply = compile(request);
  } else if (request["verb"] == "place") {
    reply = place(request);
  } else if (request["verb"] == "locate") {
    reply = locate(request);
  } else {
    reply = refuse("request", "unknown verb; there are: compile, place, locate, ping");
  }
  if (request.is_object() && request.contains("id")) reply["id"] = request["id"];
  return reply;
}

json Service::compile(const json& request) {
  if (!toolchain_.error().empty()) return refuse("compile", toolchain_.error());
  if (!request.contains("source") || !request["source"].is_string())
    return refuse("request", "compile needs \"source\": the text of the law");
  const json name = request.value("name", json("law.cpp"));
  const json joints = request.value("joints", json());
  if (!joints.is_number_unsigned() || joints < 1 || joints > kMaxJoints)
    return refuse("request", "compile needs \"joints\": how many the robot has, 1 to " + std::to_string(kMaxJoints));
  const json budget_ns = request.value("budget_ns", json());
  if (!budget_ns.is_null() && !(budget_ns.is_number() && budget_ns > 0))
    return refuse("request", "\"budget_ns\" is how long one step may take: a number above 0, or left out");
  Job job{request["source"], safe_name(name.is_string() ? name.get<std::string>() : ""), "", joints};
  if (job.source.size() > kMaxJobSourceBytes)
    return refuse_whole("compile", job.name, "the source is larger than 1 MiB");
  Admission unclear;
  const Cleaned cleaned = clean_source(job.source, unclear);
  if (!unclear.ok()) return refuse_admission(unclear, job.name, job.source);
  job.source = cleaned.text;
  job.admit = is_on(request, "admit", true);
  job.dry_run = is_on(request, "dry_run", true);
  const std::string rules = job.admit ? std::string(kAdmissionRules) : "not admitted";
  job.hash = sha256_hex(toolchain_.fingerprint() + rules + (job.dry_run ? "" : "not run") + job.source);
  const auto start = std::chrono::steady_clock::now();
  json reply = from_cache(job);
  // A time that was measured while the machine was disturbed must not refuse the law for ever: it is measured again.
  const bool cached = !reply.is_null() && over_budget(reply, job.name, budget_ns).is_null();
  if (!cached) reply = build(job);
  if (json refused = over_budget(reply, job.name, budget_ns); !refused.is_null()) reply = std::move(refused);
  if (reply.value("ok", false)) reply["toolchain"] = toolchain_.to_json();
  if (!cleaned.notes.empty()) reply["cleaned"] = cleaned.notes;
  reply["hash"] = job.hash;
  reply["cached"] = cached;
  reply["compile_ms"] = since_ms(start);
  return reply;
}

// A compiled law from the cache, by its hash, linked for the slot and written there. None of its code runs here: the
// trial is the first to run it from the slot. No process may be running a law in this slot.
json Service::place(const json& request) {
  if (!arena_) return refuse("arena", arena_error_);
  const std::string hash = hash_in(request);
  const json slot = request.value("slot", json());
  if (hash.empty() || !slot.is_number_unsigned() || slot < 1 || slot > arena::kSlots) {
    return refuse("request",
                  "place needs \"hash\", as compile answered it, and \"slot\": 1 to " + std::to_string(arena::kSlots));
  }
  const auto start = std::chrono::steady_clock::now();
  const std::string base = cache_ + "/laws/" + hash;
  const json entry = json::parse(read_file(base + ".json").value_or(""), nullptr, false);
  if (!entry.is_object()) return refuse("cache", "there is no law of this hash in the cache: compile it again");
  const auto object = read_file(base + ".o");
  if (!object || entry.value("placeable_sha256", "") != sha256_hex(*object))
    return refuse("cache", "the law's object in the cache is not what was admitted: compile it again");
  const std::string key = fmt::format("{}@{}", hash, slot.get<std::uint32_t>());
  auto linked = std::ranges::find(links_, key, &decltype(links_)::value_type::first);
  if (linked == links_.end()) {
    auto fresh = link_for_slot(toolchain_, cache_ + "/laws", base + ".o", *object, slot);
    if (const json* refusal = std::get_if<json>(&fresh)) return *refusal;
    if (links_.size() == kMaxLinks) links_.erase(links_.begin());
    linked = links_.insert(links_.end(), {key, std::get<Linked>(std::move(fresh))});
  }
  arena_->place(slot, linked->second.bytes);
  return {{"ok", true},
          {"slot", slot},
          {"entry", linked->second.entry},
          {"code_bytes", linked->second.bytes.size()},
          {"image_hash", linked->second.hash},
          {"place_ms", since_ms(start)}};
}

// Finds the source line of an offset in such a law.
json Service::locate(const json& request) const {
  const std::string hash = hash_in(request);
  const json offset = request.value("offset", json());
  if (hash.empty() || !offset.is_number_unsigned() || offset >= arena::kSlotBytes) {
    return refuse("request",
                  "locate needs \"hash\", as compile answered it, and \"offset\": bytes from its slot's start");
  }
  if (!is_on(request, "placed", true)) return own_place(cache_ + "/laws/" + hash + ".so", offset);
  return line_in_slot(toolchain_, cache_ + "/laws", cache_ + "/laws/" + hash + ".o", offset);
}

// Compiler and linker, in a folder of their own under the cache.
json Service::build(const Job& job) {
  Admission admission;
  Laps laps;
  if (job.admit) admit_source(job.source, admission);  // before the compiler opens the files that the source includes
  if (!admission.ok()) return refuse_admission(admission, job.name, job.source);
  laps.lap("admit_source");
  const ScratchDir scratch(cache_ + "/laws");
  if (scratch.path().empty()) {
    return refuse("cache", disk_is_full(scratch.error()) ? full_disk_text(cache_)
                                                         : "cannot write the law cache " + cache_ + ": " +
                                                               scratch.error() + "; set LITHE_CACHE_DIR");
  }
  const std::string file = scratch.path() + "/" + job.name, object = scratch.path() + "/law.o";
  const std::string library = scratch.path() + "/law.so";
  if (const std::string failed = write_file_whole(file, job.source); !failed.empty())
    return refuse("cache", disk_is_full(failed) ? full_disk_text(cache_) : "cannot write " + file + ": " + failed);
  std::string warnings;
  if (json refused = run_compiler(job, file, object, warnings); !refused.is_null()) return refused;
  laps.lap("compile");
  if (job.admit) admit_object({object, file}, admission);
  laps.lap("admit_object");
  if (!admission.ok()) return refuse_admission(admission, job.name, job.source);
  const Outcome link = run_program(toolchain_.link_command(object, library), Limits{});
  if (!link.clean()) {
    if (link.starved) return refuse_starved(starved_text("the linker", link));
    if (disk_is_full(link.output)) return refuse("cache", full_disk_text(cache_));
    return refuse_whole("compile", job.name, "the link failed: " + link.output);
  }
  laps.lap("link");
  json stored = try_and_store(job, object, library, warnings, admission.gates_json());
  laps.lap("dry_run_and_store");
  if (stored.value("ok", false)) stored["steps_ms"] = laps.ms();
  return stored;
}

// null on success.
json Service::run_compiler(const Job& job, const std::string& file, const std::string& object, std::string& warnings) {
  Outcome outcome = run_program(toolchain_.compile_command(file, object), compiler_);
  const bool broke = outcome.signal != 0 || outcome.output.find("internal compiler error") != std::string::npos ||
                     outcome.output.find("signal terminated program") != std::string::npos;
  if (toolchain_.precompiled() && broke && !outcome.timed_out) {
    // The precompiled header may be damaged, or the compiler was killed: try once without it. Only success shows that
    // the law was not the cause.
    outcome = run_program(toolchain_.compile_command(file, object, Toolchain::Contract::as_text), compiler_);
    if (outcome.clean()) toolchain_.precompile_again();
  }
  if (outcome.starved) return refuse_starved(starved_text("the compiler", outcome));
  if (outcome.timed_out) {
    return refuse_whole("compile", job.name,
                        fmt::format("the compiler was stopped after {:.1f} s, with {:.1f} s of the processor, and was "
                                    "not done; swap.compile_s of "
                                    "the robot file allows it {:.0f} s: make the law smaller, with fewer templates and "
                                    "constant expressions, or "
                                    "allow more",
                                    outcome.wall_ms * 1e-3, outcome.cpu_ms * 1e-3, time_factor() * compiler_.cpu_s));
  }
  if (!outcome.clean() && memory_is_full(outcome.output)) {
    return refuse_whole("compile", job.name,
                        "the compiler needs more than 1 GiB of memory: fewer macros and templates, smaller matrices");
  }
  const Help help(job.source, read_file(toolchain_.contract_dir() + "/lithe/law.hpp").value_or(""));
  const auto with_help = [&help](const std::string& message) { return help.with_help(message); };
  const Diagnostics diagnostics =
      read_diagnostics(outcome.output, {file, job.name, job.source, toolchain_.contract_dir(), with_help});
  warnings = diagnostics.text;
  if (outcome.clean()) return nullptr;
  if (disk_is_full(outcome.output)) return refuse("cache", full_disk_text(cache_));
  if (diagnostics.list.empty()) {
    const std::string why = outcome.output.empty() ? "the compiler ended without a word" : outcome.output;
    return refuse_whole("compile", job.name, why);
  }
  return refuse("compile", diagnostics.text, diagnostics.list);
}

json Service::try_and_store(const Job& job, const std::string& object, const std::string& library,
                            const std::string& warnings, const json& gates) {
  const DryRun tried = dry_run(library, job.joints, job.dry_run ? kDrySteps : 0);
  if (tried.starved) return refuse_starved(tried.reason);
  if (!tried.ok) {
    const json place = tried.pc_offset == 0 ? json::object() : own_place(library, tried.pc_offset);
    return refuse_at(tried.stage, job.name, job.source, place.value("line", 0), tried.reason);
  }
  const auto bytes = read_file(library), placeable = read_file(object);
  if (!bytes || !placeable) return refuse("cache", "cannot read back " + library);
  const std::string base = cache_ + "/laws/" + job.hash;
  json entry = {{"ok", true},
                {"object", base + ".so"},
                {"object_sha256", sha256_hex(*bytes)},
                {"placeable_sha256", sha256_hex(*placeable)},
                {"law", tried.law},
                {"warnings", warnings},
                {"dry_step_max_ns", tried.step_ns},
                {"joints", job.joints},
                {"admitted", job.admit},
                {"gates", gates},
                {"contract", toolchain_.fingerprint()}};
  std::string failed = write_file_whole(base + ".so", *bytes);
  if (failed.empty()) failed = write_file_whole(base + ".o", *placeable);
  if (failed.empty()) failed = write_file_whole(base + ".json", entry.dump());
  if (stores_++ % kStoresBetweenTidying == 0) keep_newest(cache_ + "/laws", kMostCacheBytes);
  if (failed.empty()) return entry;
  return refuse("cache", disk_is_full(failed) ? full_disk_text(cache_) : "cannot write the law cache: " + failed);
}

// The cache entry of an earlier compile, when its object is unchanged; otherwise null, and the law is compiled again.
json Service::from_cache(const Job& job) const {
  const std::string base = cache_ + "/laws/" + job.hash;
  const auto text = read_file(base + ".json");
  if (!text) return nullptr;
  const json entry = json::parse(*text, nullptr, false);
  if (!entry.is_object() || entry.value("joints", 0u) != job.joints || !entry.contains("law") ||
      !entry.contains("dry_step_max_ns")) {
    return nullptr;
  }
  for (const auto& [end, key] : {std::pair(".so", "object_sha256"), std::pair(".o", "placeable_sha256")}) {
    const auto bytes = read_file(base + end);
    if (!bytes || entry.value(key, "") != sha256_hex(*bytes)) return nullptr;
  }
  std::error_code failed;  // marks the entry as used now; the least recently used is removed first
  std::filesystem::last_write_time(base + ".json", std::filesystem::file_time_type::clock::now(), failed);
  json moved = entry;
  moved["object"] = base + ".so";  // the cache folder may have been moved
  return moved;
}

}  // namespace lithe::lawd
