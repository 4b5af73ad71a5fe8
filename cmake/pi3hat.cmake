# SPDX-License-Identifier: Apache-2.0
# The maker's library for a pi3hat, as somebody has put it on this Raspberry Pi. None of it is here, and nothing here
# builds it: it runs on that machine only, and changes registers that only its maker documents.
find_path(LITHE_PI3HAT_INCLUDE mjbots/pi3hat/pi3hat.h HINTS ${LITHE_PI3HAT_DIR} PATH_SUFFIXES include lib/cpp)
find_library(LITHE_PI3HAT_LIBRARY pi3hat HINTS ${LITHE_PI3HAT_DIR} PATH_SUFFIXES lib lib/cpp)
if(NOT LITHE_PI3HAT_INCLUDE OR NOT LITHE_PI3HAT_LIBRARY)
  message(FATAL_ERROR
    "LITHE_PI3HAT is ON, and mjbots/pi3hat/pi3hat.h or libpi3hat is not found. Get the maker's library, 1.0.0 or newer, "
    "from https://github.com/mjbots/pi3hat, build it on the Raspberry Pi, and say where its header and library are: "
    "-DLITHE_PI3HAT_DIR=/path. Without a pi3hat: -DLITHE_PI3HAT=OFF")
endif()
target_sources(lithe_hal_bus PRIVATE pi3hat/upstream.cpp)
target_include_directories(lithe_hal_bus SYSTEM PRIVATE ${LITHE_PI3HAT_INCLUDE})
target_link_libraries(lithe_hal_bus PRIVATE ${LITHE_PI3HAT_LIBRARY})
# Its constructor throws, and we catch it at once.
set_source_files_properties(${CMAKE_CURRENT_SOURCE_DIR}/pi3hat/upstream.cpp PROPERTIES COMPILE_OPTIONS "-fexceptions;-frtti")
