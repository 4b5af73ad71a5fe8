# SPDX-License-Identifier: Apache-2.0
# The toolchain of the preset `aarch64`: Debian's cross compiler, the libraries of an arm64 Debian, and QEMU, which runs
# what was built. tools/cross.py gets the libraries; docs/arm64.md tells more.
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR aarch64)

set(LITHE_ARM64_SYSROOT ${CMAKE_CURRENT_LIST_DIR}/../build/arm64/sysroot CACHE PATH "Libraries of an arm64 Debian")
get_filename_component(LITHE_ARM64_TREE ${LITHE_ARM64_SYSROOT} ABSOLUTE)
set(CMAKE_TRY_COMPILE_PLATFORM_VARIABLES LITHE_ARM64_SYSROOT)
if(NOT EXISTS ${LITHE_ARM64_TREE}/usr/include)
  message(FATAL_ERROR "${LITHE_ARM64_TREE} holds no arm64 system: `python3 tools/cross.py --sysroot` gets it, or say "
    "where one is: -DLITHE_ARM64_SYSROOT=/path/of/its/root")
endif()

set(CMAKE_C_COMPILER aarch64-linux-gnu-gcc)
set(CMAKE_CXX_COMPILER aarch64-linux-gnu-g++)
set(CMAKE_SYSROOT ${LITHE_ARM64_TREE})
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_PACKAGE ONLY)

# ctest, and the listing of tests after each build, run programs with this.
set(CMAKE_CROSSCOMPILING_EMULATOR qemu-aarch64-static -L ${LITHE_ARM64_TREE})
