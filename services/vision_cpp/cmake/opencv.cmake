# OpenCV's core and imgproc, the peer that tests and benchmarks compare with. Debian's small packages of the two come without OpenCV's own
# CMake files, which would drag in all of its modules.

find_path(OPENCV_INCLUDE opencv2/imgproc.hpp PATH_SUFFIXES opencv4 REQUIRED)
add_library(armsight_opencv INTERFACE)
# SYSTEM: its headers warn in C++20
target_include_directories(armsight_opencv SYSTEM INTERFACE ${OPENCV_INCLUDE})
foreach(module imgproc core)
  find_library(OPENCV_${module} opencv_${module} REQUIRED)
  target_link_libraries(armsight_opencv INTERFACE ${OPENCV_${module}})
endforeach()
