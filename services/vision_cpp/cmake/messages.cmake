# C++ of every message that vision uses: ours from their .proto files, Foxglove's from the descriptors in the Python
# wheel, and the table of keys. Python is needed at build time only.

find_package(Protobuf REQUIRED)
set(ARMSIGHT_PROTO ${CMAKE_CURRENT_SOURCE_DIR}/../../proto CACHE PATH "folder of the contract")
find_program(ARMSIGHT_PYTHON python PATHS ${CMAKE_CURRENT_SOURCE_DIR}/../../.venv/bin NO_DEFAULT_PATH
             DOC "Python with foxglove-schemas-protobuf")
if(NOT ARMSIGHT_PYTHON)
  message(FATAL_ERROR "no .venv with foxglove-schemas-protobuf: run `make setup`, or set -DARMSIGHT_PYTHON=")
endif()

set(generated ${CMAKE_CURRENT_BINARY_DIR}/generated)
set(foxglove ${generated}/foxglove.binpb)
file(MAKE_DIRECTORY ${generated})

set(armsight_messages geometry description joints health parameters)
set(foxglove_messages CameraCalibration FrameTransform RawImage ImageAnnotations CircleAnnotation PointsAnnotation
                      TextAnnotation Point2 Color Vector3 Quaternion KeyValuePair)
set(armsight_protos)
set(sources)
foreach(name IN LISTS armsight_messages)
  list(APPEND armsight_protos ${ARMSIGHT_PROTO}/armsight/v1/${name}.proto)
  list(APPEND sources ${generated}/armsight/v1/${name}.pb.cc)
endforeach()
set(foxglove_protos)
set(foxglove_sources)
foreach(name IN LISTS foxglove_messages)
  list(APPEND foxglove_protos foxglove/${name}.proto)
  list(APPEND foxglove_sources ${generated}/foxglove/${name}.pb.cc)
endforeach()

add_custom_command(OUTPUT ${foxglove}
                   COMMAND ${ARMSIGHT_PYTHON} ${ARMSIGHT_PROTO}/tools/dump_foxglove.py ${foxglove}
                   DEPENDS ${ARMSIGHT_PROTO}/tools/dump_foxglove.py VERBATIM)
add_custom_command(OUTPUT ${foxglove_sources}
                   COMMAND protobuf::protoc --descriptor_set_in=${foxglove} --cpp_out=${generated} ${foxglove_protos}
                   DEPENDS ${foxglove} VERBATIM)
add_custom_command(OUTPUT ${sources}
                   COMMAND protobuf::protoc -I${ARMSIGHT_PROTO} --cpp_out=${generated} ${armsight_protos}
                   DEPENDS ${armsight_protos} VERBATIM)
add_custom_command(OUTPUT ${generated}/armsight/topics.hpp
                   COMMAND ${ARMSIGHT_PYTHON} ${ARMSIGHT_PROTO}/tools/generate_topics_header.py
                           ${ARMSIGHT_PROTO}/armsight/topics.toml ${generated}/armsight/topics.hpp
                   DEPENDS ${ARMSIGHT_PROTO}/tools/generate_topics_header.py ${ARMSIGHT_PROTO}/armsight/topics.toml
                   VERBATIM)

add_library(armsight_messages STATIC ${sources} ${foxglove_sources} ${generated}/armsight/topics.hpp)
target_include_directories(armsight_messages SYSTEM PUBLIC ${generated})
target_link_libraries(armsight_messages PUBLIC protobuf::libprotobuf)
