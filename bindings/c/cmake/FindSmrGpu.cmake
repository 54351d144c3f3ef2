# Finds smr-gpu's C library. Defines the target SmrGpu::SmrGpu; set SmrGpu_ROOT to where it is installed.
find_path(SmrGpu_INCLUDE_DIR smr_gpu.h)
find_library(SmrGpu_LIBRARY smr_gpu)
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(SmrGpu REQUIRED_VARS SmrGpu_LIBRARY SmrGpu_INCLUDE_DIR)
if(SmrGpu_FOUND AND NOT TARGET SmrGpu::SmrGpu)
  add_library(SmrGpu::SmrGpu UNKNOWN IMPORTED)
  set_target_properties(SmrGpu::SmrGpu PROPERTIES
    IMPORTED_LOCATION "${SmrGpu_LIBRARY}" INTERFACE_INCLUDE_DIRECTORIES "${SmrGpu_INCLUDE_DIR}")
endif()
mark_as_advanced(SmrGpu_INCLUDE_DIR SmrGpu_LIBRARY)
