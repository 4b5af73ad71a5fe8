# SPDX-License-Identifier: Apache-2.0
# The maker's library for a pi3hat, compiled from where somebody has put it. None of it is here, and nothing is fetched:
# its own build would fetch more, and makes no library that could be found.
set(maker_source)
foreach(below IN ITEMS /lib/cpp "")
  if(LITHE_PI3HAT_DIR AND EXISTS ${LITHE_PI3HAT_DIR}${below}/mjbots/pi3hat/pi3hat.cc)
    get_filename_component(maker_source ${LITHE_PI3HAT_DIR}${below} ABSOLUTE)
    break()
  endif()
endforeach()
if(NOT maker_source)
  message(FATAL_ERROR
    "LITHE_PI3HAT is ON, and lib/cpp/mjbots/pi3hat/pi3hat.cc is not in LITHE_PI3HAT_DIR ('${LITHE_PI3HAT_DIR}'). Get the "
    "maker's sources, 1.0.0 or newer (git clone https://github.com/mjbots/pi3hat; nothing of it needs to be built), and say "
    "where they are: -DLITHE_PI3HAT_DIR=/path/of/pi3hat. Without a pi3hat: -DLITHE_PI3HAT=OFF")
endif()
# A library of its own: it writes its variables while the robot runs, and those of the Spine are read-only then.
add_library(lithe_pi3hat_maker SHARED ${maker_source}/mjbots/pi3hat/pi3hat.cc)
target_compile_options(lithe_pi3hat_maker PRIVATE -w)
target_include_directories(lithe_pi3hat_maker SYSTEM INTERFACE ${maker_source})
target_sources(lithe_hal_bus_pi3hat PRIVATE bus/pi3hat/port/upstream.cpp)
target_link_libraries(lithe_hal_bus_pi3hat PRIVATE lithe_pi3hat_maker)
# Its constructor throws, and we catch it at once.
set_source_files_properties(${CMAKE_CURRENT_SOURCE_DIR}/bus/pi3hat/port/upstream.cpp PROPERTIES SKIP_PRECOMPILE_HEADERS ON COMPILE_OPTIONS "-fexceptions;-frtti")
