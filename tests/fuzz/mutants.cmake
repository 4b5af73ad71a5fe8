# SPDX-License-Identifier: Apache-2.0
# Broken twins of the code under test: one line of one source is exchanged, and the target must notice. They are built and
# run by `make check-all`; that each line still exists is a test of every run.
add_custom_target(mutants)

# lithe_mutant(<name> <target> <source> <line> <spoilt line>): the test Fuzz.<target>.refutes.<name>
function(lithe_mutant name target source line spoilt)
  file(READ ${CMAKE_SOURCE_DIR}/${source} text)
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${CMAKE_SOURCE_DIR}/${source})
  string(REPLACE "${line}" "${spoilt}" mutated "${text}")
  set(test Fuzz.${target}.refutes.${name})
  if(mutated STREQUAL text)
    add_test(NAME ${test} COMMAND ${CMAKE_COMMAND} -E echo "${source} has no such line any more: ${line}")
    set(label fuzz)
  else()
    set(label mutant)
    set(copy ${CMAKE_CURRENT_BINARY_DIR}/mutants/${name}.cpp)
    file(CONFIGURE OUTPUT ${copy} CONTENT "${mutated}" @ONLY)
    get_target_property(links fuzz_${target} LINK_LIBRARIES)
    # Before the library that holds the sound object, which is then not taken from there.
    add_executable(mutant_${name} EXCLUDE_FROM_ALL ${copy} $<TARGET_OBJECTS:fuzz_${target}_code> $<TARGET_OBJECTS:fuzz_driver>)
    target_link_libraries(mutant_${name} PRIVATE ${links})
    target_compile_options(mutant_${name} PRIVATE -w ${LITHE_LIGHT})
    add_dependencies(mutants mutant_${name})
    add_test(NAME ${test} COMMAND mutant_${name})
  endif()
  set_tests_properties(${test} PROPERTIES PASS_REGULAR_EXPRESSION "refuted: " TIMEOUT 300 LABELS ${label})
endfunction()

# What the fuzzers must notice: each line once did harm, or would.
set(hal spine/hal)
lithe_mutant(believes_wrong_sums fdcanusb ${hal}/bus/fdcanusb/fdcanusb_codec.cpp
  "if (sum == Sum::wrong || (sum == Sum::absent" "if ((sum == Sum::absent")
lithe_mutant(takes_any_frame fdcanusb ${hal}/bus/fdcanusb/fdcanusb_codec.cpp "return is_can(frame);" "return true;")
lithe_mutant(begins_a_line_anew fdcanusb ${hal}/bus/serial/text_bus.cpp
  "if (line_size_ == kLongestLine) too_long_ = true;" "if (line_size_ == kLongestLine) line_size_ = 0;")
lithe_mutant(takes_refusals_for_nonsense slcan ${hal}/bus/serial/text_bus.cpp "++statistics_.errors;" "++statistics_.malformed;")
lithe_mutant(takes_any_id slcan ${hal}/bus/slcan/slcan_codec.cpp
  "return frame.id <= (frame.extended ? kLargestId : kLargestStandardId);" "return true;")
lithe_mutant(forgets_to_count_remotes socketcan ${hal}/bus/socketcan/socketcan_bus.cpp "++statistics_.ignored;" ";")
lithe_mutant(loses_the_last_byte socketcan ${hal}/bus/socketcan/socketcan_codec.cpp
  "copy_n(raw.data, heard.size," "copy_n(raw.data, heard.size / 2,")
lithe_mutant(believes_any_torque moteus ${hal}/moteus/moteus.cpp "std::abs(torque_nm) <= kMaxTorqueNm" "true")
lithe_mutant(sends_what_no_float_holds moteus ${hal}/moteus/moteus.cpp
  "return std::abs(value) <= kMaxCommand;" "return std::isfinite(value);")
lithe_mutant(scales_by_any_gain moteus ${hal}/moteus/moteus_setup.cpp "return gain >= 1e-9 && gain <= 1e9;" "return gain > 0;")
lithe_mutant(reads_beyond_the_frame moteus ${hal}/moteus/moteus_codec.cpp
  "if (bytes > rest_.size()) return false;" "if (bytes > rest_.size() + 4) return false;")
lithe_mutant(listens_for_ever moteus_terminal ${hal}/moteus/moteus_terminal.cpp
  "if (time_.now_ns() >= end_ns) return Error" "if (time_.now_ns() >= end_ns && !heard) return Error")
lithe_mutant(takes_any_objects_answer canopen ${hal}/canopen/canopen_sdo.cpp
  "kind == kSegmentAnswer || sdo_address(frame) != address_" "kind == kSegmentAnswer")
lithe_mutant(asks_for_ever canopen ${hal}/canopen/canopen_sdo.cpp
  "attempts_ < kTimeoutsNs.size() ? Phase::start : Phase::failed" "(attempts_ %= kTimeoutsNs.size(), Phase::start)")
lithe_mutant(says_another_number canopen ${hal}/cia402/sim/sim_cia402_objects.cpp
  "foreign ? kInputsAndOutputs : dictionary_.raw(slot)" "dictionary_.raw(slot) + 1")
lithe_mutant(believes_any_speed cia402 ${hal}/cia402/cia402_answers.cpp
  "if (std::abs(motor_rev_s) > kMaxMotorRevPerS ||" "if (")
lithe_mutant(forgets_the_torque_limit cia402 ${hal}/cia402/cia402_setpoint_limiter.cpp
  "std::clamp(joint_nm, -limit_nm, limit_nm)" "joint_nm")
lithe_mutant(steps_as_it_likes cia402 ${hal}/cia402/cia402_setpoint_limiter.cpp
  "catches_up_ = std::abs(gap) > (catches_up_ ? std::min(slow_counts_, reach) : reach);" "catches_up_ = false;")
lithe_mutant(takes_what_came_before cia402 ${hal}/cia402/cia402_answers.cpp
  "if (!exchange.asked || commanded_" "if (commanded_")
lithe_mutant(takes_older_frames gateway ${hal}/gateway/gateway.cpp "ahead == 0 || ahead > 128" "ahead == 0")
lithe_mutant(takes_invalid_channels gateway ${hal}/gateway/gateway.cpp "raw != kInvalid}" "true}")
lithe_mutant(turns_into_nothing sim_moteus ${hal}/moteus/sim/servo.cpp "if (!std::isfinite(wanted_nm_)) wanted_nm_ = 0;" "")
lithe_mutant(answers_unasked sim_moteus ${hal}/moteus/sim/sim_moteus.cpp "|| (frame.id & kReplyRequested) == 0) return;" ") return;")
lithe_mutant(is_too_strong sim_cia402 ${hal}/cia402/sim/cia402_servo.cpp
  "return std::clamp(torque_nm, least_nm, most_nm);" "return torque_nm;")
lithe_mutant(takes_old_answers exchange ${hal}/bus_actuators.cpp "exchange_.number % kSources" "exchange_.number % 16")
lithe_mutant(takes_every_answer exchange ${hal}/moteus/moteus.cpp
  "if (!exchange.asked || source_of(frame) != exchange.source)" "if (!exchange.asked)")
lithe_mutant(forgets_to_count_late exchange ${hal}/bus_actuators.cpp "++late_answers_;" ";")
lithe_mutant(forgets_to_count_strays exchange ${hal}/bus_actuators.cpp "++counters_.stray;" ";")
lithe_mutant(takes_what_is_not_measured exchange ${hal}/bus_actuators.cpp "if (!sample.measured) {" "if (false) {")
lithe_mutant(is_fresh_for_ever exchange ${hal}/bus_actuators.cpp
  "last_.status[index] &= ~wire::joint_status::kFresh;" "")
lithe_mutant(has_no_room_to_move robot_toml spine/robot/robot.cpp
  "if (joint.position_min_rad >= joint.position_max_rad &&" "if (false &&")
lithe_mutant(asks_never robot_toml spine/robot/keys/sections.cpp
  "device.rate_divider, {1, 1000}" "device.rate_divider, {0, 1000}")
lithe_mutant(follows_beyond_the_limits segments spine/plan/check.cpp
  "return decision(PlanReject::position_limit, *rad, limit.position_max_rad);" "return decision(PlanReject::none);")
lithe_mutant(forgets_to_count_repeated exchange ${hal}/bus_actuators.cpp
  "counters_.duplicate += place.device->repeated();" "")
