# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
# What a wheel for rclpy needs of the interfaces, and no more: C structures, their Python
# classes, and the two type supports in C that rmw_fastrtps_cpp loads, one to send and
# introspection to announce the type.  All that is for C++ stays out.

set(_generators
  rosidl_generator_type_description
  rosidl_generator_c
  rosidl_typesupport_fastrtps_c
  rosidl_typesupport_introspection_c
  rosidl_typesupport_c
  rosidl_generator_py
)
set(_wanted "")
foreach(_extension IN LISTS AMENT_EXTENSIONS_rosidl_generate_idl_interfaces)
  string(REGEX REPLACE ":.*" "" _generator "${_extension}")
  if(_generator IN_LIST _generators)
    list(APPEND _wanted "${_extension}")
  endif()
endforeach()
set(AMENT_EXTENSIONS_rosidl_generate_idl_interfaces "${_wanted}")
foreach(_generator IN LISTS _generators)
  set(${_generator}_BIN "${CMAKE_CURRENT_LIST_DIR}/generate.py")
endforeach()

# Python takes its type support from C's, which finds the other two at run time.
macro(rosidl_generator_py_get_typesupports _result)
  set(${_result} rosidl_typesupport_c)
endmacro()

# A message of Python takes as long with -O3, as the calls of Python outweigh the rest.
set(CMAKE_C_FLAGS_RELEASE "-O1 -DNDEBUG")
set(CMAKE_CXX_FLAGS_RELEASE "-O1 -DNDEBUG")

# Most of a compiler's time goes into reading the same headers: merge the sources of a library.
# The descriptions of types stay apart, as each names its parts alike.
set(CMAKE_UNITY_BUILD ON)
set(CMAKE_UNITY_BUILD_BATCH_SIZE 20)
function(_leave_descriptions_apart)
  get_target_property(_sources ${PROJECT_NAME}__rosidl_generator_c SOURCES)
  list(FILTER _sources INCLUDE REGEX "__description[.]c$")
  set_source_files_properties(${_sources} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
endfunction()
cmake_language(DEFER CALL _leave_descriptions_apart)
