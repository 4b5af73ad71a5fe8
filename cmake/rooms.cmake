# SPDX-License-Identifier: Apache-2.0
# One CMake target per room. A room links only what the table in ARCHITECTURE.md allows it;
# tools/rooms.py holds the includes to the same table.

find_package(GTest REQUIRED)
include(GoogleTest)

# Half of what a file costs to compile is reading GoogleTest, nlohmann/json and the standard library, so all that need the
# same read them once. Not with clang: it refuses a precompiled header where a target has definitions of its own.
# lithe_headers(<name> OPTIONS <option>... LINKS <target>... HEADERS <header>...): one such reading.
function(lithe_headers name)
  cmake_parse_arguments(READ "" "" "OPTIONS;LINKS;HEADERS" ${ARGN})
  file(CONFIGURE OUTPUT ${CMAKE_BINARY_DIR}/${name}.cpp CONTENT "// nothing\n")
  add_library(${name} OBJECT ${CMAKE_BINARY_DIR}/${name}.cpp)
  target_link_libraries(${name} PRIVATE lithe_flags ${READ_LINKS})
  target_compile_options(${name} PRIVATE ${READ_OPTIONS})
  target_precompile_headers(${name} PRIVATE ${READ_HEADERS})
endfunction()

# Tests are compiled without optimisation, in half the time. Not those whose own code races with other threads, or takes
# millions of steps: their labels are these.
set(LITHE_OPTIMISED_TESTS "^(tick.)?(ipc|law|contain|plan|limits|faults)$")
if(CMAKE_CXX_COMPILER_ID STREQUAL GNU)
  find_package(fmt REQUIRED)
  find_package(nlohmann_json REQUIRED)
  set(test_headers <gtest/gtest.h> <algorithm> <array> <atomic> <cmath> <filesystem> <fstream> <functional> <random>
    <string> <thread> <vector>)
  lithe_headers(lithe_json_headers LINKS fmt::fmt HEADERS <nlohmann/json.hpp> <fmt/format.h>)
  if(LITHE_TESTS)
    lithe_headers(lithe_test_headers LINKS GTest::gtest OPTIONS -O0 HEADERS ${test_headers})
    lithe_headers(lithe_test_json_headers LINKS GTest::gtest OPTIONS -O0 HEADERS ${test_headers} <nlohmann/json.hpp>)
    lithe_headers(lithe_optimised_test_headers LINKS GTest::gtest HEADERS ${test_headers})
  endif()
endif()

# lithe_room(<name> [TICK] [DIRS <folder>...] [LINKS <target>...] [TEST_LINKS <target>...] [PLAIN <x_test>...])
#   Every *.cpp of the folders (this one, if DIRS is not given) but *_test.cpp and main.cpp becomes the library
#   lithe_<name>; every x_test.cpp becomes the test program <name>_x_test.
#   TICK: runs in the tick, so built without exceptions and RTTI.
#   TEST_LINKS: of its tests alone.
#   PLAIN: tests that a sanitizer build leaves out, because what they test cannot live with one.
#   The target <name>_tests builds a room's tests, tick_tests those of all TICK rooms; its label in ctest is
#   <name>, or tick.<name>.
add_custom_target(tick_tests)
function(lithe_room name)
  cmake_parse_arguments(ROOM "TICK" "" "DIRS;LINKS;TEST_LINKS;PLAIN" ${ARGN})
  if(NOT ROOM_DIRS)
    set(ROOM_DIRS .)
  endif()
  set(sources)
  foreach(folder IN LISTS ROOM_DIRS)
    file(GLOB files CONFIGURE_DEPENDS ${folder}/*.cpp)
    list(APPEND sources ${files})
  endforeach()
  set(tests ${sources})
  list(FILTER tests INCLUDE REGEX "_test\\.cpp$")
  list(FILTER sources EXCLUDE REGEX "(_test|/main)\\.cpp$")
  if(sources)
    add_library(lithe_${name} STATIC ${sources})
    target_link_libraries(lithe_${name} PUBLIC lithe_flags ${ROOM_LINKS})
    if(nlohmann_json::nlohmann_json IN_LIST ROOM_LINKS)
      # Most of what these files cost is reading json and making code of it: with LITHE_UNITY five are compiled as one.
      set_target_properties(lithe_${name} PROPERTIES UNITY_BUILD ${LITHE_UNITY} UNITY_BUILD_BATCH_SIZE 5)
      if(TARGET lithe_json_headers AND fmt::fmt IN_LIST ROOM_LINKS)
        target_precompile_headers(lithe_${name} REUSE_FROM lithe_json_headers)
      else()
        target_precompile_headers(lithe_${name} PRIVATE <nlohmann/json.hpp> <fmt/format.h>)
      endif()
      if(CMAKE_CXX_COMPILER_ID STREQUAL GNU AND CMAKE_CXX_COMPILER_VERSION VERSION_LESS 13)
        # From a precompiled header, <string> is no system header to it any more: it reports copies of short texts there.
        target_compile_options(lithe_${name} PRIVATE -Wno-array-bounds -Wno-stringop-overflow -Wno-stringop-overread)
      endif()
    endif()
    if(ROOM_TICK)
      target_compile_options(lithe_${name} PRIVATE -fno-exceptions -fno-rtti)
    endif()
  else()
    add_library(lithe_${name} INTERFACE)
    target_link_libraries(lithe_${name} INTERFACE lithe_flags ${ROOM_LINKS})
  endif()
  set(json)
  if(nlohmann_json::nlohmann_json IN_LIST ROOM_LINKS)
    set(json JSON)
  endif()
  add_custom_target(${name}_tests)
  set(label ${name})
  if(ROOM_TICK)
    set(label tick.${name})
    add_dependencies(tick_tests ${name}_tests)
  endif()
  foreach(test IN LISTS tests)
    get_filename_component(stem ${test} NAME_WE)
    if(LITHE_SANITIZE AND stem IN_LIST ROOM_PLAIN)
      continue()
    endif()
    lithe_test(${name}_${stem} SOURCES ${test} LINKS lithe_${name} ${ROOM_TEST_LINKS} LABEL ${label} ${json})
    if(TARGET ${name}_${stem})
      add_dependencies(${name}_tests ${name}_${stem})
    endif()
  endforeach()
endfunction()

# lithe_test(<name> SOURCES <file>... LINKS <target>... [LABEL <label>] [JSON]): one GoogleTest program, one ctest
# entry per test. JSON: its room reads nlohmann/json.
function(lithe_test name)
  cmake_parse_arguments(TEST "JSON" "LABEL" "SOURCES;LINKS" ${ARGN})
  if(NOT LITHE_TESTS)
    return()
  endif()
  add_executable(${name} ${TEST_SOURCES})
  target_link_libraries(${name} PRIVATE ${TEST_LINKS} GTest::gtest GTest::gtest_main)
  if(CMAKE_CXX_COMPILER_ID STREQUAL GNU)
    if(TEST_LABEL MATCHES "${LITHE_OPTIMISED_TESTS}")
      target_precompile_headers(${name} REUSE_FROM lithe_optimised_test_headers)
    else()
      target_compile_options(${name} PRIVATE -O0)
      set(headers lithe_test_headers)
      if(TEST_JSON)
        set(headers lithe_test_json_headers)
      endif()
      target_precompile_headers(${name} REUSE_FROM ${headers})
    endif()
    if(CMAKE_CXX_COMPILER_VERSION VERSION_LESS 13)  # see lithe_room
      target_compile_options(${name} PRIVATE -Wno-array-bounds -Wno-stringop-overflow -Wno-stringop-overread)
    endif()
  endif()
  gtest_discover_tests(${name} DISCOVERY_TIMEOUT 600 PROPERTIES TIMEOUT 600 LABELS "${TEST_LABEL}")
endfunction()
