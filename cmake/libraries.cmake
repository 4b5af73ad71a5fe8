# SPDX-License-Identifier: Apache-2.0
# C libraries that come without CMake files of their own.

# lithe_library(<name> <header> <package>): the target lithe::<name> links lib<name>.
function(lithe_library name header package)
  find_path(LITHE_${name}_HEADER ${header})
  find_library(LITHE_${name}_LIBRARY ${name})
  if(NOT LITHE_${name}_HEADER OR NOT LITHE_${name}_LIBRARY)
    message(FATAL_ERROR "<${header}> or lib${name} is missing: apt install ${package} (or tools/setup)")
  endif()
  add_library(lithe::${name} INTERFACE IMPORTED GLOBAL)
  target_include_directories(lithe::${name} SYSTEM INTERFACE ${LITHE_${name}_HEADER})
  target_link_libraries(lithe::${name} INTERFACE ${LITHE_${name}_LIBRARY})
endfunction()

lithe_library(elf libelf.h libelf-dev)
lithe_library(md sha256.h libmd-dev)
lithe_library(seccomp seccomp.h libseccomp-dev)
lithe_library(z zlib.h zlib1g-dev)
