// SPDX-License-Identifier: Apache-2.0
// Follows a law after its commit until it leaves the Spine: confirmed, rolled back, retired. Keeps its certificate up
// to date.
#pragma once

#include <cstdint>
#include <deque>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "supervisor/link/spine/metrics.hpp"
#include "supervisor/link/spine/spine_link.hpp"
#include "supervisor/swap/certificate/certificate_files.hpp"
#include "supervisor/swap/certificate/swap_state.hpp"

namespace lithe::control {

// Contract: one thread · never blocks · knows only the laws passed to follow(), not those of an earlier supervisor
class LawLifecycle {
 public:
  // Called when a certificate has changed.
  using Keep = std::function<void(const SwapState&, const CertificateFiles::Page&)>;
  // Finds the source line of a law fault at this offset from the start of its slot [bytes]; 0: an output was not
  // finite, so there is no address. Answers at any time with {"where", "function"}, or null when the line cannot be
  // found.
  using Found = std::function<void(const Json& place)>;
  using Locate = std::function<void(const SwapState& swap, std::uint32_t offset, Found found)>;
  // What the measured control says about a law that was rolled back, one sentence.
  using Explain = std::function<void(const SwapState& swap, const std::string& sentence)>;
  static constexpr std::size_t kFaultsKept = 8;
  // Tracking is compared over probation_s before and after the commit, each at most this long [s]: up to 1.3 kHz the
  // telemetry ring still has both.
  static constexpr double kControlS = 1.5;
  static constexpr std::int64_t kMeasureAfterNs = 60'000'000;  // a little more than kWindowS of metrics.hpp

  LawLifecycle(const SpineLink& spine, Keep keep, Locate locate = {}, Explain explain = {});

  // `before`: the counters when the request was sent to the Loader.
  void follow(SwapState swap, CertificateFiles::Page record, const CoreCounts& before, std::int64_t now_ns);
  // Measures every law whose measuring time has come.
  void serve(std::int64_t now_ns);
  // Measures all laws that are still unmeasured now: counts after this moment belong to the next law.
  void measure_all();
  void on_event(const wire::Event& event);
  // Sets a section in the certificate of a law that is still in the Spine.
  void note(std::uint64_t request_id, const std::string& section, Json what);
  // How a resident law did: its verdict and, once measured, rms_error_rad by joint, clamped and missed_ticks. Null: it
  // is not known, such as one that an earlier supervisor swapped in.
  Json score_of(std::uint32_t law_id) const;
  // The certificate of a resident law; empty: it is not known, or could not be written.
  std::filesystem::path page_of(std::uint32_t law_id) const;
  // Of all resident laws.
  std::vector<std::filesystem::path> pages() const;
  // The newest law faults (at most kFaultsKept), oldest first, as in their certificates.
  const Json& faults() const { return told_; }
  // The robot stops, or its Spine has ended: writes the final verdict of every law.
  void end(const std::string& why, std::int64_t now_ns);

 private:
  struct Life {
    SwapState swap;
    CertificateFiles::Page record;
    CoreCounts before;
    std::int64_t measure_at_ns;  // 0 = it was done
    std::int64_t control_at_ns;  // likewise, of its control
    std::string fault;           // why it is about to be replaced; empty = no fault
    bool asked = false;          // the source line was asked for, the answer is not here yet
    bool retired = false;        // it has left the Spine; only that answer is missing
  };

  void measure(Life& life);
  // Writes the tracking of the old and the new law into the certificate. `why`: reason of the rollback; if given, a
  // sentence explains what the joints did.
  void measure_control(Life& life, const std::string& why = "");
  Life* of_request(std::uint64_t request_id);
  Life* of_law(std::uint32_t law_id);
  std::optional<wire::LawFault> record_of(const wire::Event& event);
  void faulted(const wire::Event& event);
  void tell_fault(Life& life, Json fault);
  void locate(Life& life, const wire::LawFault& fault);
  void retired(const wire::Event& event);
  void rolled_back(const wire::Event& event);
  // `runs_now`: id of the law that took over; 0 = none.
  void leave(Life& life, const std::string& why, const wire::Event& event, std::uint32_t runs_now);

  const SpineLink& spine_;
  Keep keep_;
  Locate locate_;
  Explain explain_;
  Json told_ = Json::array();
  ipc::RingReader<wire::LawFault, wire::spine_segment::kLawFaultsDepth> faults_;
  std::deque<wire::LawFault> unreported_;  // read from the ring, their events not seen yet
  std::deque<Life> lives_;                 // oldest commit first
  std::vector<std::uint32_t> running_;     // law ids in the order of their commits; a rollback removes the last ones
};

}  // namespace lithe::control
