# secondskin_library(NAME [HEADERS h...] [SOURCES s...] [PUBLIC target...] [PRIVATE target...])
# One folder, one target secondskin::NAME. Headers are included as "folder/file.h" in the tree
# and, once installed, from include/secondskin; each must compile alone.
function(secondskin_library name)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "" "HEADERS;SOURCES;PUBLIC;PRIVATE")
  set(target secondskin_${name})
  add_library(${target} STATIC ${arg_SOURCES})
  add_library(secondskin::${name} ALIAS ${target})
  set_target_properties(${target} PROPERTIES EXPORT_NAME ${name} VERIFY_INTERFACE_HEADER_SETS ON)
  target_compile_features(${target} PUBLIC cxx_std_20)
  target_sources(${target} PUBLIC FILE_SET HEADERS BASE_DIRS ${PROJECT_SOURCE_DIR}
                 FILES ${arg_HEADERS})
  target_link_libraries(${target} PUBLIC ${arg_PUBLIC} PRIVATE ${arg_PRIVATE})
  install(TARGETS ${target} EXPORT secondskinTargets
          ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR}
          FILE_SET HEADERS DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/secondskin)
endfunction()

function(add_test_group group test)
  if(NOT TARGET ${group})
    add_custom_target(${group})
  endif()
  add_dependencies(${group} ${test})
endfunction()

# secondskin_npm_check(NAME): installs NAME_check/ of this folder, a check.mjs with packages from npm,
# before the tests of CHECK NAME.
function(secondskin_npm_check name)
  add_test(NAME ${name}_check_install
           COMMAND ${CMAKE_COMMAND} -DSOURCE=${CMAKE_CURRENT_SOURCE_DIR}/${name}_check
                   -DTARGET=${PROJECT_BINARY_DIR}/${name}_check
                   -P ${PROJECT_SOURCE_DIR}/tests/install_npm.cmake)
  set_tests_properties(${name}_check_install PROPERTIES FIXTURES_SETUP ${name}_check TIMEOUT 300)
endfunction()

# secondskin_test(NAME SOURCES s... [LINK target...] [LABELS l...] [TIMEOUT s] [CHECK c] [DEPENDS target...])
# One GoogleTest program; the tests find the repository's data through SECONDSKIN_SOURCE_DIR, and what
# secondskin_npm_check(c) installed through SECONDSKIN_C_CHECK.
function(secondskin_test name)
  cmake_parse_arguments(PARSE_ARGV 1 arg "" "TIMEOUT;CHECK" "SOURCES;LINK;LABELS;DEPENDS")
  add_executable(${name} ${arg_SOURCES})
  target_link_libraries(${name} PRIVATE ${arg_LINK} GTest::gtest GTest::gmock GTest::gtest_main)
  target_include_directories(${name} PRIVATE ${PROJECT_SOURCE_DIR})
  target_compile_definitions(${name} PRIVATE
    SECONDSKIN_SOURCE_DIR="${PROJECT_SOURCE_DIR}"
    SECONDSKIN_PROGRAM="$<TARGET_FILE_DIR:${name}>/secondskin")
  if(arg_CHECK)
    string(TOUPPER ${arg_CHECK} check)
    target_compile_definitions(${name} PRIVATE
      SECONDSKIN_${check}_CHECK="${PROJECT_BINARY_DIR}/${arg_CHECK}_check/check.mjs")
    set(fixture FIXTURES_REQUIRED ${arg_CHECK}_check)
  endif()
  if(arg_DEPENDS)
    add_dependencies(${name} ${arg_DEPENDS})
  endif()
  # What ./check builds under the sanitizers: tests_plain without, tests_threads with.
  if(NOT "process" IN_LIST arg_LABELS)
    add_test_group(tests_plain ${name})
  endif()
  if("threads" IN_LIST arg_LABELS)
    add_test_group(tests_threads ${name})
  endif()
  if(NOT arg_TIMEOUT)
    set(arg_TIMEOUT 120)
  endif()
  # Tests that start processes or DDS domains run one after another: they measure time.
  if("process" IN_LIST arg_LABELS)
    set(serial RUN_SERIAL TRUE)
  endif()
  gtest_discover_tests(${name} DISCOVERY_TIMEOUT 60
    TEST_LIST ${name}_TESTS
    PROPERTIES TIMEOUT ${arg_TIMEOUT} ${serial} ${fixture}
    # The user's own files are not a test's.
    ENVIRONMENT XDG_DATA_HOME=${PROJECT_BINARY_DIR}/tests/own_files)
  # gtest_discover_tests splits a list of labels; so they are set once the tests are known.
  set(labels_file ${CMAKE_CURRENT_BINARY_DIR}/${name}_labels.cmake)
  file(WRITE ${labels_file}
       "if(${name}_TESTS)\n  set_tests_properties(\${${name}_TESTS} PROPERTIES LABELS \"${arg_LABELS}\")\nendif()\n")
  set_property(DIRECTORY APPEND PROPERTY TEST_INCLUDE_FILES ${labels_file})
endfunction()
