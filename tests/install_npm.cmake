# Installs the packages of a check in JavaScript beside a copy of its check.mjs: cmake -DSOURCE=... -DTARGET=... -P install_npm.cmake
# Nothing to do, and no network needed, when what is installed is of the same lock file.
find_program(NODE node)
find_program(NPM npm)
if(NOT NODE OR NOT NPM)
  message(FATAL_ERROR "node and npm are needed for the check in ${SOURCE}; "
                      "the set-up script installs them")
endif()
file(MAKE_DIRECTORY ${TARGET})
file(COPY ${SOURCE}/package.json ${SOURCE}/package-lock.json ${SOURCE}/check.mjs DESTINATION ${TARGET})
file(SHA256 ${SOURCE}/package-lock.json wanted)
set(installed "")
if(EXISTS ${TARGET}/installed)
  file(READ ${TARGET}/installed installed)
endif()
if(NOT installed STREQUAL wanted)
  execute_process(COMMAND ${NPM} ci --ignore-scripts --no-audit --no-fund
                  WORKING_DIRECTORY ${TARGET} COMMAND_ERROR_IS_FATAL ANY)
  file(WRITE ${TARGET}/installed ${wanted})
endif()
