// Writes one message of each type with the OpenIGTLink library, as lines of a name and hexadecimal bytes. core/links/igtl/tests/golden.rs builds it
// against Debian's libopenigtlink-dev and compares its output with library.txt.

#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include <igtlCapabilityMessage.h>
#include <igtlImageMessage.h>
#include <igtlPointMessage.h>
#include <igtlPolyDataMessage.h>
#include <igtlPositionMessage.h>
#include <igtlStatusMessage.h>
#include <igtlStringMessage.h>
#include <igtlTrackingDataMessage.h>
#include <igtlTransformMessage.h>

static void write(const char* name, igtl::MessageBase* message) {
  message->SetDeviceName("Device");
  message->SetTimeStamp(1700000000u, 0x40000000u);
  message->Pack();
  const unsigned char* bytes = static_cast<const unsigned char*>(message->GetPackPointer());
  std::printf("%s ", name);
  for (int k = 0; k < message->GetPackSize(); ++k) std::printf("%02x", bytes[k]);
  std::printf("\n");
}

static void matrix(igtl::Matrix4x4& m, float scale) {
  // A quarter turn about z and a translation.
  const float values[4][4] = {{0, -1, 0, 10 * scale}, {1, 0, 0, 20 * scale}, {0, 0, 1, 30 * scale}, {0, 0, 0, 1}};
  std::memcpy(m, values, sizeof values);
}

int main() {
  igtl::Matrix4x4 m;
  matrix(m, 1);
  {
    igtl::TransformMessage::Pointer message = igtl::TransformMessage::New();
    message->SetMatrix(m);
    write("transform", message);
  }
  // The library writes past the end of its buffer for the shorter forms of POSITION.
  {
    igtl::PositionMessage::Pointer message = igtl::PositionMessage::New();
    message->SetPosition(1, 2, 3);
    message->SetQuaternion(0, 0, 0.6f, 0.8f);
    write("position", message);
  }
  {
    igtl::ImageMessage::Pointer message = igtl::ImageMessage::New();
    message->SetDimensions(3, 2, 1);
    message->SetSpacing(0.5f, 0.5f, 0.5f);
    message->SetScalarType(igtl::ImageMessage::TYPE_UINT8);
    message->SetNumComponents(3);
    message->SetEndian(igtl::ImageMessage::ENDIAN_LITTLE);
    message->SetCoordinateSystem(igtl::ImageMessage::COORDINATE_RAS);
    message->AllocateScalars();
    for (int k = 0; k < 18; ++k) static_cast<unsigned char*>(message->GetScalarPointer())[k] = 10 * k;
    write("image", message);
  }
  {
    igtl::ImageMessage::Pointer message = igtl::ImageMessage::New();
    int size[3] = {4, 3, 1}, part[3] = {2, 1, 1}, start[3] = {1, 2, 0};
    message->SetDimensions(size);
    message->SetSpacing(1, 1, 1);
    message->SetSubVolume(part, start);
    message->SetScalarType(igtl::ImageMessage::TYPE_UINT16);
    message->SetEndian(igtl::ImageMessage::ENDIAN_BIG);
    message->SetCoordinateSystem(igtl::ImageMessage::COORDINATE_LPS);
    message->AllocateScalars();
    const unsigned char pixels[4] = {1, 2, 3, 4};
    std::memcpy(message->GetScalarPointer(), pixels, sizeof pixels);
    write("image_part", message);
  }
  {
    igtl::PointMessage::Pointer message = igtl::PointMessage::New();
    igtl::PointElement::Pointer first = igtl::PointElement::New();
    first->SetName("Target");
    first->SetGroupName("Landmark");
    first->SetRGBA(255, 128, 0, 255);
    first->SetPosition(1.5f, -2.5f, 3.5f);
    first->SetRadius(4);
    first->SetOwner("Picture");
    message->AddPointElement(first);
    igtl::PointElement::Pointer second = igtl::PointElement::New();
    second->SetName("Entry");
    second->SetGroupName("Fiducial");
    second->SetRGBA(0, 0, 255, 64);
    second->SetPosition(7, 8, 9);
    second->SetRadius(0);
    second->SetOwner("");
    message->AddPointElement(second);
    write("point", message);
  }
  {
    igtl::PolyDataMessage::Pointer message = igtl::PolyDataMessage::New();
    igtl::PolyDataPointArray::Pointer points = igtl::PolyDataPointArray::New();
    for (int k = 0; k < 4; ++k) points->AddPoint(k, 2 * k, 3 * k);
    message->SetPoints(points);
    igtl::PolyDataCellArray::Pointer vertices = igtl::PolyDataCellArray::New();
    igtlUint32 alone[1] = {3};
    vertices->AddCell(1, alone);
    message->SetVertices(vertices);
    igtl::PolyDataCellArray::Pointer lines = igtl::PolyDataCellArray::New();
    igtlUint32 line[2] = {0, 1};
    lines->AddCell(2, line);
    message->SetLines(lines);
    igtl::PolyDataCellArray::Pointer polygons = igtl::PolyDataCellArray::New();
    igtlUint32 one[3] = {0, 1, 2}, two[4] = {0, 1, 2, 3};
    polygons->AddCell(3, one);
    polygons->AddCell(4, two);
    message->SetPolygons(polygons);
    igtl::PolyDataCellArray::Pointer strips = igtl::PolyDataCellArray::New();
    strips->AddCell(4, two);
    message->SetTriangleStrips(strips);
    igtlFloat32 values[12];
    for (int k = 0; k < 12; ++k) values[k] = 0.25f * k;
    igtl::PolyDataAttribute::Pointer scalars = igtl::PolyDataAttribute::New();
    scalars->SetType(igtl::PolyDataAttribute::POINT_SCALAR, 1);
    scalars->SetSize(4);
    scalars->SetName("heat");
    scalars->SetData(values);
    message->AddAttribute(scalars);
    igtl::PolyDataAttribute::Pointer normals = igtl::PolyDataAttribute::New();
    normals->SetType(igtl::PolyDataAttribute::POINT_NORMAL);
    normals->SetSize(4);
    normals->SetName("up");
    normals->SetData(values);
    message->AddAttribute(normals);
    write("polydata", message);
  }
  {
    igtl::TrackingDataMessage::Pointer message = igtl::TrackingDataMessage::New();
    igtl::TrackingDataElement::Pointer tool = igtl::TrackingDataElement::New();
    tool->SetName("Grasper");
    tool->SetType(igtl::TrackingDataElement::TYPE_6D);
    tool->SetMatrix(m);
    message->AddTrackingDataElement(tool);
    igtl::TrackingDataElement::Pointer tip = igtl::TrackingDataElement::New();
    tip->SetName("Tip");
    tip->SetType(igtl::TrackingDataElement::TYPE_3D);
    igtl::Matrix4x4 other;
    matrix(other, 2);
    tip->SetMatrix(other);
    message->AddTrackingDataElement(tip);
    write("tdata", message);
  }
  {
    igtl::StatusMessage::Pointer message = igtl::StatusMessage::New();
    message->SetCode(igtl::StatusMessage::STATUS_NOT_FOUND);
    message->SetSubCode(-42);
    char name[20] = "Missing";
    message->SetErrorName(name);
    message->SetStatusString("no such file");
    write("status", message);
  }
  {
    igtl::StringMessage::Pointer message = igtl::StringMessage::New();
    message->SetString("a text");
    write("string", message);
  }
  {
    igtl::CapabilityMessage::Pointer message = igtl::CapabilityMessage::New();
    std::vector<std::string> kinds;
    kinds.push_back("IMAGE");
    kinds.push_back("TRANSFORM");
    kinds.push_back("GET_STATUS");
    message->SetTypes(kinds);
    write("capability", message);
  }
  {
    igtl::StartTrackingDataMessage::Pointer message = igtl::StartTrackingDataMessage::New();
    message->SetResolution(50);
    message->SetCoordinateName("Patient");
    write("stt_tdata", message);
  }
  {
    igtl::StopTrackingDataMessage::Pointer message = igtl::StopTrackingDataMessage::New();
    write("stp_tdata", message);
  }
  {
    igtl::RTSTrackingDataMessage::Pointer message = igtl::RTSTrackingDataMessage::New();
    message->SetStatus(igtl::RTSTrackingDataMessage::STATUS_ERROR);
    write("rts_tdata", message);
  }
  {
    igtl::GetCapabilityMessage::Pointer message = igtl::GetCapabilityMessage::New();
    write("get_capabil", message);
  }
  return 0;
}
