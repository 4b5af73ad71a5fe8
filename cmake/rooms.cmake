# SPDX-License-Identifier: Apache-2.0
# One CMake target per room. A room links only what the table in ARCHITECTURE.md allows it;
# tools/rooms.py holds the includes to the same table.

if(LITHE_TESTS)
  find_package(GTest REQUIRED)
  include(GoogleTest)
endif()

# Half of what a file costs to compile is reading GoogleTest, nlohmann/json and the standard library, so all that need the
# same read them once.
# lithe_headers(<name> OPTIONS <option>... LINKS <target>... HEADERS <header>...): one such reading.
function(lithe_headers name)
  cmake_parse_arguments(READ "" "" "OPTIONS;LINKS;HEADERS" ${ARGN})
  file(CONFIGURE OUTPUT ${CMAKE_BINARY_DIR}/${name}.cpp CONTENT "// nothing\n")
  add_library(${name} OBJECT ${CMAKE_BINARY_DIR}/${name}.cpp)
  target_link_libraries(${name} PRIVATE lithe_flags ${READ_LINKS})
  target_compile_options(${name} PRIVATE ${READ_OPTIONS})
  target_precompile_headers(${name} PRIVATE ${READ_HEADERS})
endfunction()

# From a precompiled header, <string> is no system header to GCC 12 any more: it reports copies of short texts there.
function(lithe_trust_string target)
  if(CMAKE_CXX_COMPILER_ID STREQUAL GNU AND CMAKE_CXX_COMPILER_VERSION VERSION_LESS 13)
    target_compile_options(${target} PRIVATE -Wno-array-bounds -Wno-stringop-overflow -Wno-stringop-overread)
  endif()
endfunction()

# Rooms that use json wait for people, files and other processes. Optimised less, they compile in two thirds of the time.
set(LITHE_LIGHT $<$<CONFIG:Release>:-O1>)
# lithe_light(<target>): so is one of their libraries or programs.
function(lithe_light target)
  target_compile_options(${target} PRIVATE ${LITHE_LIGHT})
  if(TARGET lithe_json_headers)
    target_precompile_headers(${target} REUSE_FROM lithe_json_headers)
  endif()
  lithe_trust_string(${target})
endfunction()

# Tests are compiled without optimisation, in half the time. Those whose own code races with other threads, or takes
# millions of steps, are optimised as little as the rooms above: their labels are these.
set(LITHE_OPTIMISED_TESTS "^(tick.)?(ipc|law|contain|plan|limits|faults)$")
if(NOT CMAKE_DISABLE_PRECOMPILE_HEADERS)
  find_package(fmt REQUIRED)
  find_package(nlohmann_json REQUIRED)
  set(test_headers <gtest/gtest.h> <algorithm> <array> <atomic> <cmath> <filesystem> <fstream> <functional> <random>
    <string> <thread> <vector>)
  lithe_headers(lithe_tick_headers OPTIONS -fno-exceptions -fno-rtti HEADERS
    <algorithm> <array> <atomic> <cmath> <cstring> <functional> <limits> <memory> <optional> <span> <string> <vector>)
  lithe_headers(lithe_json_headers LINKS fmt::fmt OPTIONS ${LITHE_LIGHT} HEADERS <nlohmann/json.hpp> <fmt/format.h>)
  if(LITHE_TESTS)
    lithe_headers(lithe_test_headers LINKS GTest::gtest OPTIONS -O0 HEADERS ${test_headers})
    lithe_headers(lithe_test_json_headers LINKS GTest::gtest OPTIONS -O0 HEADERS ${test_headers} <nlohmann/json.hpp>)
    lithe_headers(lithe_optimised_test_headers LINKS GTest::gtest OPTIONS ${LITHE_LIGHT} HEADERS ${test_headers})
  endif()
endif()

# lithe_room(<name> [TICK] [DIRS <folder>...] [LINKS <target>...] [TEST_LINKS <target>...]
#            [PLAIN <x_test>...] [ALONE <x_test>...] [APART <x>...])
#   Every *.cpp of the folders (this one, if DIRS is not given) but *_test.cpp and main.cpp becomes the library
#   lithe_<name>; all *_test.cpp become one test program, <name>_tests.
#   TICK: runs in the tick, so built without exceptions and RTTI.
#   TEST_LINKS: of its tests alone.
#   PLAIN: test files that a sanitizer build leaves out, because what they test cannot live with one.
#   ALONE: test files that are a program each, <name>_x_test, because the others must not link what these link.
#   APART: files that are compiled in a step of their own also with LITHE_UNITY, because a name in their anonymous
#   namespace is in another file of the room, too.
#   The target <name>_tests builds a room's tests, tick_tests those of all TICK rooms; its label in ctest is
#   <name>, or tick.<name>.
add_custom_target(tick_tests)
function(lithe_room name)
  cmake_parse_arguments(ROOM "TICK" "" "DIRS;LINKS;TEST_LINKS;PLAIN;ALONE;APART" ${ARGN})
  if(NOT ROOM_DIRS)
    set(ROOM_DIRS .)
  endif()
  set(sources)
  foreach(folder IN LISTS ROOM_DIRS)
    file(GLOB files CONFIGURE_DEPENDS ${folder}/*.cpp)
    list(APPEND sources ${files})
  endforeach()
  foreach(file IN LISTS sources)
    get_filename_component(stem ${file} NAME_WE)
    if(stem IN_LIST ROOM_APART)
      set_source_files_properties(${file} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
    endif()
  endforeach()
  set(tests ${sources})
  list(FILTER tests INCLUDE REGEX "_test\\.cpp$")
  list(FILTER sources EXCLUDE REGEX "(_test|/main)\\.cpp$")
  set(json)
  if(nlohmann_json::nlohmann_json IN_LIST ROOM_LINKS)
    set(json JSON)
  endif()
  if(sources)
    add_library(lithe_${name} STATIC ${sources})
    target_link_libraries(lithe_${name} PUBLIC lithe_flags ${ROOM_LINKS})
    if(json)
      lithe_light(lithe_${name})
    endif()
    if(ROOM_TICK)
      target_compile_options(lithe_${name} PRIVATE -fno-exceptions -fno-rtti)
      if(TARGET lithe_tick_headers)
        target_precompile_headers(lithe_${name} REUSE_FROM lithe_tick_headers)
        lithe_trust_string(lithe_${name})
      endif()
    endif()
    # With g++, a room of the tick has an object for each file: a faulty variant of the fuzzers takes the place of one.
    if(NOT ROOM_TICK OR CMAKE_CXX_COMPILER_ID MATCHES Clang)
      set_target_properties(lithe_${name} PROPERTIES UNITY_BUILD ${LITHE_UNITY} UNITY_BUILD_BATCH_SIZE 10)
    endif()
  else()
    add_library(lithe_${name} INTERFACE)
    target_link_libraries(lithe_${name} INTERFACE lithe_flags ${ROOM_LINKS})
  endif()
  if(NOT LITHE_TESTS)
    return()
  endif()

  set(label ${name})
  if(ROOM_TICK)
    set(label tick.${name})
  endif()
  set(together)
  set(programs)
  foreach(test IN LISTS tests)
    get_filename_component(stem ${test} NAME_WE)
    if(LITHE_SANITIZE AND stem IN_LIST ROOM_PLAIN)
      continue()
    endif()
    if(stem IN_LIST ROOM_ALONE)
      lithe_test(${name}_${stem} SOURCES ${test} LINKS lithe_${name} ${ROOM_TEST_LINKS} LABEL ${label} ${json})
      list(APPEND programs ${name}_${stem})
    else()
      list(APPEND together ${test})
    endif()
  endforeach()
  if(together)
    lithe_test(${name}_tests SOURCES ${together} LINKS lithe_${name} ${ROOM_TEST_LINKS} LABEL ${label} ${json})
    set_target_properties(${name}_tests PROPERTIES UNITY_BUILD ${LITHE_UNITY} UNITY_BUILD_BATCH_SIZE 10)
  else()
    add_custom_target(${name}_tests)
  endif()
  if(programs)
    add_dependencies(${name}_tests ${programs})
  endif()
  if(ROOM_TICK)
    add_dependencies(tick_tests ${name}_tests)
  endif()
endfunction()

# lithe_test(<name> SOURCES <file>... LINKS <target>... [LABEL <label>] [JSON]): one GoogleTest program, one ctest
# entry, and one process, per test. LITHE_ROBOTS is the folder of the robot files. JSON: its room reads nlohmann/json.
function(lithe_test name)
  cmake_parse_arguments(TEST "JSON" "LABEL" "SOURCES;LINKS" ${ARGN})
  if(NOT LITHE_TESTS)
    return()
  endif()
  add_executable(${name} ${TEST_SOURCES})
  target_link_libraries(${name} PRIVATE ${TEST_LINKS} lithe_no_alloc GTest::gtest GTest::gtest_main)
  target_compile_definitions(${name} PRIVATE LITHE_ROBOTS="${CMAKE_SOURCE_DIR}/robots")
  # `if (a) EXPECT_TRUE(b);`: there is an else in the macro, and the formatter takes the braces away.
  target_compile_options(${name} PRIVATE -Wno-dangling-else)
  set(headers lithe_test_headers)
  if(TEST_LABEL MATCHES "${LITHE_OPTIMISED_TESTS}")
    set(headers lithe_optimised_test_headers)
    target_compile_options(${name} PRIVATE ${LITHE_LIGHT})
  else()
    target_compile_options(${name} PRIVATE -O0)
    if(TEST_JSON)
      set(headers lithe_test_json_headers)
    endif()
  endif()
  if(TARGET ${headers})
    target_precompile_headers(${name} REUSE_FROM ${headers})
    lithe_trust_string(${name})
  endif()
  gtest_discover_tests(${name} DISCOVERY_TIMEOUT 600 PROPERTIES TIMEOUT 600 LABELS "${TEST_LABEL}")
endfunction()

# lithe_stress(<room> <filter>): those tests of a room ten times over, where a processor is emulated: its threads meet at
# other instructions there. Label: stress.
function(lithe_stress room filter)
  if(LITHE_TESTS AND CMAKE_CROSSCOMPILING)
    add_test(NAME Stress.${room} COMMAND ${room}_tests --gtest_filter=${filter} --gtest_repeat=10 --gtest_brief=1)
    set_tests_properties(Stress.${room} PROPERTIES TIMEOUT 1800 LABELS stress PROCESSORS 2
                         FAIL_REGULAR_EXPRESSION "0 tests from 0 test;FAILED")
  endif()
endfunction()
