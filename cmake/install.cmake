# The program's data beside it, and a package that find_package(secondskin) finds.
include(CMakePackageConfigHelpers)

set(data_dir ${CMAKE_INSTALL_DATADIR}/secondskin)
install(FILES idl/qos.xml idl/secondskin_msgs.idl DESTINATION ${data_dir}/idl)
install(DIRECTORY idl/foxglove DESTINATION ${data_dir}/idl)
install(DIRECTORY joint_maps body_maps plans marker_sets suits garments calibration_objects reference_motions DESTINATION ${data_dir})
# The page, where clients/dashboard/web/build has built it.
install(DIRECTORY clients/dashboard/web/dist/ DESTINATION ${data_dir}/dashboard OPTIONAL
        PATTERN .stamp EXCLUDE)

set(package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/secondskin)
install(EXPORT secondskinTargets NAMESPACE secondskin:: DESTINATION ${package_dir})
configure_package_config_file(cmake/secondskinConfig.cmake.in
  ${PROJECT_BINARY_DIR}/secondskinConfig.cmake INSTALL_DESTINATION ${package_dir})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/secondskinConfigVersion.cmake
  COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/secondskinConfig.cmake
              ${PROJECT_BINARY_DIR}/secondskinConfigVersion.cmake DESTINATION ${package_dir})
