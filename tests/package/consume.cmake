# Installs the build into a prefix of its own, then configures, builds and runs the consumer against
# it, and the installed program away from the source tree.
function(run)
  execute_process(COMMAND ${ARGV} RESULT_VARIABLE result OUTPUT_VARIABLE output
                  ERROR_VARIABLE output)
  if(NOT result EQUAL 0)
    message(FATAL_ERROR "${ARGV}\n${output}")
  endif()
  set(output "${output}" PARENT_SCOPE)
endfunction()

file(REMOVE_RECURSE ${SCRATCH})
run(${CMAKE_COMMAND} --install ${BUILD} --prefix ${SCRATCH}/prefix)
run(${CMAKE_COMMAND} -S ${CONSUMER} -B ${SCRATCH}/build -G Ninja -DCMAKE_BUILD_TYPE=Release
    -DCMAKE_PREFIX_PATH=${SCRATCH}/prefix)
run(${CMAKE_COMMAND} --build ${SCRATCH}/build)
run(${SCRATCH}/build/consumer ${SCRATCH}/prefix/share/secondskin)
if(NOT output MATCHES "left knee bends to 1[0-9][0-9] degrees")
  message(FATAL_ERROR "the consumer said: ${output}")
endif()
run(${SCRATCH}/prefix/bin/secondskin reference list)
if(NOT output MATCHES "squat")
  message(FATAL_ERROR "the installed program said: ${output}")
endif()
