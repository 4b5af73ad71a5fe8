// SPDX-License-Identifier: Apache-2.0
#include "spine/load/loader.hpp"

#include <elf.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "spine/law/test/slot_rig.hpp"
#include "spine/load/law_store.hpp"

namespace lithe::load {
namespace {

using wire::EventKind;
using wire::StageResult;

class LoaderTest : public ::testing::Test {
 protected:
  void SetUp() override {
    char name[] = "/tmp/lithe_loader_XXXXXX";
    dir_ = mkdtemp(name);
  }
  void TearDown() override { std::filesystem::remove_all(dir_); }

  // Sends a request through the mailbox, as the supervisor does.
  std::uint64_t send(const std::string& path) {
    wire::StageRequest request = next_;
    request.request_id = ++request_id_;
    path.copy(request.path.data(), request.path.size());
    const auto ticket = sender_.send(request);
    return ticket.value_or(0);
  }
  StageResult answer(std::uint64_t ticket) { return static_cast<StageResult>(sender_.poll(ticket)); }

  StageResult stage(const std::string& path) {
    const std::uint64_t ticket = send(path);
    while (loader_.poll(now_ns_)) {
    }
    return answer(ticket);
  }
  // The oldest event not yet seen.
  wire::Event event() {
    wire::Event event;
    if (!events_.next(event)) ADD_FAILURE() << "no event";
    return event;
  }
  std::string refusal() {
    const wire::Event e = event();
    EXPECT_EQ(e.kind, static_cast<std::uint32_t>(EventKind::law_refused));
    EXPECT_EQ(e.request_id, request_id_);
    return e.text.data();
  }
  std::string file(const std::string& name, const std::string& bytes) {
    std::ofstream(dir_ + "/" + name, std::ios::binary) << bytes;
    return dir_ + "/" + name;
  }
  void commit() {
    ASSERT_TRUE(law::commit_next(slot_).has_value());
    while (loader_.poll(now_ns_)) {
    }
  }
  void tick() {
    Effort effort;
    slot_.active()->step(Tick{}, effort, probes_);
  }
  wire::LawInfo info(std::uint32_t index) {
    wire::LawInfo info;
    ipc::ChannelReader<wire::LawInfo>(spine_->law_info[index]).read(info);
    return info;
  }

  wire::StageRequest next_;  // what the next request says besides
  std::string dir_;
  std::uint64_t request_id_ = 100;
  std::int64_t now_ns_ = 1;
  std::unique_ptr<ipc::SpineMemory> spine_ = std::make_unique<ipc::SpineMemory>();
  std::unique_ptr<ipc::ControlMemory> control_ = std::make_unique<ipc::ControlMemory>();
  ipc::MailboxSender<wire::StageRequest, wire::control_segment::kStageDepth> sender_{control_->stage,
                                                                                     spine_->stage_ack};
  ipc::RingReader<wire::Event, wire::spine_segment::kEventsLoaderDepth> events_{spine_->events_loader};
  law::Slot slot_;
  DlopenStore store_;
  std::unique_ptr<law::Sandbox> sandbox_ = std::make_unique<law::Sandbox>();
  Rehearsal rehearsal_{*spine_, 1, 1e-3, *sandbox_};
  Loader loader_{slot_, store_, *spine_, *control_, rehearsal_};
  std::array<double, kMaxProbes> probes_{};
};

TEST_F(LoaderTest, ParametersOfARequestAreInForceFromTheFirstTickOn) {
  next_.param_count = 1;
  next_.param_value[0] = 0.25;
  EXPECT_EQ(stage(OBJECT_counter), StageResult::staged);
  commit();
  EXPECT_EQ(slot_.active()->params[0].value, 0.25);
  slot_.active()->revert_params();
  EXPECT_EQ(slot_.active()->params[0].value, 0.25) << "it was never tried as compiled";
}

TEST_F(LoaderTest, ParametersThatAreNotTheLawsAreRefused) {
  const auto refuses = [this](std::uint32_t count, std::uint32_t index, double value) {
    next_.param_count = count;
    next_.param_index[0] = index;
    next_.param_value[0] = value;
    EXPECT_EQ(stage(OBJECT_counter), StageResult::hostile) << count << " " << index << " " << value;
    EXPECT_NE(refusal().find("a parameter of the request"), std::string::npos);
  };
  refuses(1, 1, 0.5);
  refuses(1, 0xffffffff, 0.5);
  refuses(1, 0, std::nan(""));
  refuses(1, 0, 1e9);
  refuses(wire::kNparam + 1, 0, 0.5);
}

TEST_F(LoaderTest, StagedLawIsCommittedDescribedAndStepsFromItsDefaults) {
  EXPECT_EQ(stage(OBJECT_counter), StageResult::staged);
  const wire::Event e = event();
  EXPECT_EQ(e.kind, static_cast<std::uint32_t>(EventKind::law_staged));
  EXPECT_EQ(e.code, 1u) << "law id";
  EXPECT_STREQ(e.text.data(), "counter");
  commit();
  tick();
  EXPECT_EQ(probes_[0], 1) << "the dry call must not leave traces in the state";
  const wire::LawInfo i = info(slot_.active()->index);
  EXPECT_EQ(i.law_id, 1u);
  EXPECT_EQ(i.request_id, request_id_);
  EXPECT_STREQ(i.name.data(), "counter");
  EXPECT_STREQ(i.param_name.data(), "gain_nm");
  EXPECT_EQ(i.param_value[0], 0.5);
  EXPECT_STREQ(i.probe_name.data(), "steps");
  const LitheLaw& law = *slot_.active()->descriptor;
  ASSERT_EQ(i.state_field_count, law.state_count);
  ASSERT_GT(i.state_field_count, 0u);
  EXPECT_STREQ(i.state_name.data(), law.state[0].name);
  EXPECT_EQ(i.state_kind[0], law.state[0].kind);
  EXPECT_EQ(i.state_offset[0], law.state[0].offset);
  EXPECT_EQ(i.state_elements[0], law.state[0].count);
}

TEST_F(LoaderTest, SameObjectAgainIsANewLawWithTheOldState) {
  stage(OBJECT_counter);
  commit();
  tick();
  EXPECT_EQ(stage(OBJECT_counter), StageResult::staged);
  commit();
  tick();
  EXPECT_EQ(slot_.active()->law_id, 2u);
  EXPECT_EQ(probes_[0], 2);
  ASSERT_TRUE(slot_.rollback());
  tick();
  EXPECT_EQ(probes_[0], 3);
}

TEST_F(LoaderTest, AnImpossibleHeadOfItsMailboxIsCountedWhereAUserCanSeeIt) {
  EXPECT_FALSE(loader_.poll(now_ns_));
  EXPECT_EQ(spine_->health.stage_violations, 0U);
  control_->stage.head += 100;
  EXPECT_FALSE(loader_.poll(now_ns_));
  EXPECT_EQ(spine_->health.stage_violations, 1U);
}

TEST_F(LoaderTest, ThousandSwapsNeverRunOutOfPlaces) {
  for (std::uint32_t swap = 1; swap <= 1000; ++swap) {
    ASSERT_EQ(stage(OBJECT_counter), StageResult::staged) << swap;
    commit();
    if (swap % 3 == 0) slot_.rollback();
    tick();
  }
  EXPECT_EQ(slot_.active()->law_id, 1000u);
}

TEST_F(LoaderTest, RetiredLawIsToldAndItsInfoCleared) {
  for (std::uint32_t i = 0; i < law::kHistory + 2; ++i) {
    stage(OBJECT_counter);
    commit();
  }
  std::vector<std::uint32_t> retired;
  wire::Event e;
  while (events_.next(e))
    if (e.kind == static_cast<std::uint32_t>(EventKind::law_retired)) retired.push_back(e.code);
  EXPECT_EQ(retired, std::vector<std::uint32_t>{1});
  std::uint32_t resident = 0;
  for (std::uint32_t i = 0; i < law::kResidents; ++i) resident += info(i).law_id != 0;
  EXPECT_EQ(resident, law::kHistory + 1) << "active and those a rollback may bring back";
}

TEST_F(LoaderTest, SecondRequestWaitsForTheTickOfTheFirst) {
  const std::uint64_t first = send(OBJECT_counter), second = send(OBJECT_counter);
  while (loader_.poll(now_ns_)) {
  }
  EXPECT_EQ(answer(first), StageResult::staged);
  EXPECT_EQ(answer(second), StageResult::pending);
  commit();
  EXPECT_EQ(answer(second), StageResult::staged);
}

TEST_F(LoaderTest, LawThatNoTickCommitsIsTakenBack) {
  EXPECT_EQ(stage(OBJECT_counter), StageResult::staged);
  event();
  loader_.poll(now_ns_ + kCommitTimeoutNs);
  EXPECT_NE(refusal().find("no tick committed"), std::string::npos);
  EXPECT_FALSE(law::commit_next(slot_).has_value());
  EXPECT_EQ(stage(OBJECT_counter), StageResult::staged) << "its index is free again";
}

TEST_F(LoaderTest, WrongAbiNamesExpectedAndFound) {
  EXPECT_EQ(stage(OBJECT_wrong_abi), StageResult::abi_mismatch);
  const std::string text = refusal();
  EXPECT_NE(text.find(std::to_string(kMaxJoints) + " joints"), std::string::npos) << text;
  EXPECT_NE(text.find(std::to_string(kMaxJoints + 1) + " joints"), std::string::npos) << text;
}

TEST_F(LoaderTest, ObjectWithoutALawIsRefused) {
  EXPECT_EQ(stage(OBJECT_no_law), StageResult::load_failed);
  EXPECT_NE(refusal().find("LITHE_LAW"), std::string::npos);
}

TEST_F(LoaderTest, OutputThatIsNotFiniteInTheDryCallIsRefused) {
  EXPECT_EQ(stage(OBJECT_not_finite), StageResult::dry_run_failed);
  EXPECT_NE(refusal().find("torque_nm[0] is not finite"), std::string::npos);
}

TEST_F(LoaderTest, PathThatIsNoPathIsHostile) {
  EXPECT_EQ(stage(std::string(400, '/')), StageResult::hostile) << "no terminating zero";
  EXPECT_EQ(stage(""), StageResult::hostile);
  EXPECT_EQ(stage("libm.so.6"), StageResult::hostile) << "must not search the library path";
}

TEST_F(LoaderTest, WhatIsNotAnObjectIsRefusedBeforeTheLinkerSeesIt) {
  EXPECT_EQ(stage(dir_ + "/missing.so"), StageResult::load_failed);
  EXPECT_NE(refusal().find("no such file"), std::string::npos);
  EXPECT_EQ(stage(dir_), StageResult::load_failed);
  EXPECT_NE(refusal().find("not a regular file"), std::string::npos);
  EXPECT_EQ(stage(file("empty.so", "")), StageResult::load_failed);
  EXPECT_NE(refusal().find("not an ELF"), std::string::npos);
  EXPECT_EQ(stage(file("pd.cpp", std::string(5000, 'x'))), StageResult::load_failed);
  EXPECT_NE(refusal().find("not an ELF"), std::string::npos);
  EXPECT_EQ(stage("/dev/zero"), StageResult::load_failed);
  const std::string pipe = dir_ + "/pipe";
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  EXPECT_EQ(stage(pipe), StageResult::load_failed) << "a pipe without a writer must not hold the Loader";
}

TEST_F(LoaderTest, ObjectCutShortAnywhereIsRefusedAndNothingElseHappens) {
  std::ifstream in(OBJECT_counter, std::ios::binary);
  const std::string whole((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  const Elf64_Ehdr* head = reinterpret_cast<const Elf64_Ehdr*>(whole.data());
  const auto* segments = reinterpret_cast<const Elf64_Phdr*>(whole.data() + head->e_phoff);
  std::size_t loaded = 0;  // what the linker maps; section headers and debug information lie behind
  for (int i = 0; i < head->e_phnum; ++i) loaded = std::max(loaded, segments[i].p_offset + segments[i].p_filesz);
  for (std::size_t size = 0; size < loaded; size += 1 + loaded / 64)
    EXPECT_NE(check_object(file("short.so", whole.substr(0, size)).c_str()), nullptr) << size;
  EXPECT_EQ(stage(file("short.so", whole.substr(0, loaded / 2))), StageResult::load_failed);
}

TEST_F(LoaderTest, RefusedRequestChangesNothingForTheRunningLaw) {
  stage(OBJECT_counter);
  commit();
  tick();
  stage(OBJECT_wrong_abi);
  stage(dir_ + "/missing.so");
  EXPECT_FALSE(law::commit_next(slot_).has_value());
  tick();
  EXPECT_EQ(probes_[0], 2);
}

TEST_F(LoaderTest, LoaderThreadServesATickThatNeverStops) {
  std::atomic<bool> stop{false};
  std::thread loading([&] { loader_.run(stop); });
  std::uint32_t commits = 0, sent = 0;
  for (std::uint64_t k = 0; commits < 20 && k < 100'000; ++k) {
    if (sent == commits && send(OBJECT_counter) != 0) ++sent;
    if (slot_.active() != nullptr) tick();
    if (law::commit_next(slot_)) ++commits;
    std::this_thread::sleep_for(std::chrono::microseconds(100));
  }
  stop.store(true);
  loading.join();
  EXPECT_EQ(commits, 20u);
}

}  // namespace
}  // namespace lithe::load
