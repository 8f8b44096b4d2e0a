// A program on the OpenIGTLink library at the other end of a connection. tests/library.rs builds it against Debian's libopenigtlink-dev.
//
//   library_peer serve PORT     waits for a client and sends it one message of each type, again and again
//   library_peer listen PORT    connects and prints what arrives, until the server says that it ends
//   library_peer ask PORT       connects, makes requests and prints the answers

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include <igtlCapabilityMessage.h>
#include <igtlClientSocket.h>
#include <igtlImageMessage.h>
#include <igtlMessageHeader.h>
#include <igtlOSUtil.h>
#include <igtlPointMessage.h>
#include <igtlPolyDataMessage.h>
#include <igtlPositionMessage.h>
#include <igtlServerSocket.h>
#include <igtlStatusMessage.h>
#include <igtlStringMessage.h>
#include <igtlTrackingDataMessage.h>
#include <igtlTransformMessage.h>

static int send(igtl::Socket* socket, igtl::MessageBase* message, const char* device) {
  message->SetDeviceName(device);
  igtl::TimeStamp::Pointer now = igtl::TimeStamp::New();
  now->GetTime();
  message->SetTimeStamp(now);
  message->Pack();
  return socket->Send(message->GetPackPointer(), message->GetPackSize());
}

static void quarter_turn(igtl::Matrix4x4& m, float x) {
  const float values[4][4] = {{0, -1, 0, x}, {1, 0, 0, 20}, {0, 0, 1, 30}, {0, 0, 0, 1}};
  std::memcpy(m, values, sizeof values);
}

static int serve(int port) {
  igtl::ServerSocket::Pointer server = igtl::ServerSocket::New();
  if (server->CreateServer(port) < 0) return 3;
  std::printf("listening\n");
  std::fflush(stdout);
  igtl::ClientSocket::Pointer client = server->WaitForConnection(20000);
  if (client.IsNull()) return 4;
  for (int k = 0; k < 2000; ++k) {
    igtl::Matrix4x4 m;
    quarter_turn(m, 10);
    igtl::TransformMessage::Pointer transform = igtl::TransformMessage::New();
    transform->SetMatrix(m);
    if (!send(client, transform, "ToolToTracker")) break;

    igtl::PositionMessage::Pointer position = igtl::PositionMessage::New();
    position->SetPosition(1, 2, 3);
    position->SetQuaternion(0, 0, 0.6f, 0.8f);
    if (!send(client, position, "Probe")) break;

    igtl::ImageMessage::Pointer image = igtl::ImageMessage::New();
    image->SetDimensions(3, 2, 1);
    image->SetScalarType(igtl::ImageMessage::TYPE_UINT8);
    image->SetNumComponents(3);
    image->AllocateScalars();
    for (int b = 0; b < 18; ++b) static_cast<unsigned char*>(image->GetScalarPointer())[b] = 10 * b;
    if (!send(client, image, "Video")) break;

    igtl::PointMessage::Pointer points = igtl::PointMessage::New();
    igtl::PointElement::Pointer point = igtl::PointElement::New();
    point->SetName("Target");
    point->SetGroupName("Landmark");
    point->SetRGBA(255, 0, 0, 255);
    point->SetPosition(1.5f, -2.5f, 3.5f);
    point->SetRadius(4);
    point->SetOwner("Video");
    points->AddPointElement(point);
    if (!send(client, points, "Targets")) break;

    igtl::PolyDataMessage::Pointer mesh = igtl::PolyDataMessage::New();
    igtl::PolyDataPointArray::Pointer corners = igtl::PolyDataPointArray::New();
    corners->AddPoint(0, 0, 50);
    corners->AddPoint(1, 0, 50);
    corners->AddPoint(0, 1, 50);
    mesh->SetPoints(corners);
    igtl::PolyDataCellArray::Pointer faces = igtl::PolyDataCellArray::New();
    igtlUint32 face[3] = {0, 1, 2};
    faces->AddCell(3, face);
    mesh->SetPolygons(faces);
    if (!send(client, mesh, "Mesh")) break;

    igtl::TrackingDataMessage::Pointer tracking = igtl::TrackingDataMessage::New();
    igtl::TrackingDataElement::Pointer tool = igtl::TrackingDataElement::New();
    tool->SetName("Grasper");
    tool->SetType(igtl::TrackingDataElement::TYPE_6D);
    tool->SetMatrix(m);
    tracking->AddTrackingDataElement(tool);
    if (!send(client, tracking, "Tracker")) break;

    igtl::StatusMessage::Pointer status = igtl::StatusMessage::New();
    status->SetCode(igtl::StatusMessage::STATUS_BUSY);
    char name[20] = "Busy";
    status->SetErrorName(name);
    status->SetStatusString("calibrating");
    if (!send(client, status, "State")) break;

    igtl::StringMessage::Pointer words = igtl::StringMessage::New();
    words->SetString("a text");
    if (!send(client, words, "Words")) break;
    igtl::Sleep(10);
  }
  client->CloseSocket();
  return 0;
}

// Reads one message with its CRC checked and prints it. Returns its type; empty at the end of the connection.
static std::string next(igtl::Socket* socket) {
  igtl::MessageHeader::Pointer header = igtl::MessageHeader::New();
  header->InitPack();
  if (socket->Receive(header->GetPackPointer(), header->GetPackSize()) != header->GetPackSize()) return "";
  header->Unpack();
  const std::string kind = header->GetDeviceType();
  const char* device = header->GetDeviceName();
  igtl::MessageBase::Pointer message;
  if (kind == "TRANSFORM") message = igtl::TransformMessage::New().GetPointer();
  else if (kind == "POSITION") message = igtl::PositionMessage::New().GetPointer();
  else if (kind == "IMAGE") message = igtl::ImageMessage::New().GetPointer();
  else if (kind == "POINT") message = igtl::PointMessage::New().GetPointer();
  else if (kind == "POLYDATA") message = igtl::PolyDataMessage::New().GetPointer();
  else if (kind == "TDATA") message = igtl::TrackingDataMessage::New().GetPointer();
  else if (kind == "RTS_TDATA") message = igtl::RTSTrackingDataMessage::New().GetPointer();
  else if (kind == "STATUS") message = igtl::StatusMessage::New().GetPointer();
  else if (kind == "STRING") message = igtl::StringMessage::New().GetPointer();
  else if (kind == "CAPABILITY") message = igtl::CapabilityMessage::New().GetPointer();
  else {
    socket->Skip(header->GetBodySizeToRead(), 1);
    std::printf("%s %s skipped\n", kind.c_str(), device);
    return kind;
  }
  message->SetMessageHeader(header);
  message->AllocatePack();
  if (message->GetPackBodySize() > 0) socket->Receive(message->GetPackBodyPointer(), message->GetPackBodySize());
  if (!(message->Unpack(1) & igtl::MessageHeader::UNPACK_BODY)) {
    std::printf("%s %s damaged\n", kind.c_str(), device);
    return kind;
  }
  std::printf("%s %s", kind.c_str(), device);
  if (kind == "TRANSFORM") {
    igtl::Matrix4x4 m;
    static_cast<igtl::TransformMessage*>(message.GetPointer())->GetMatrix(m);
    for (int row = 0; row < 3; ++row) std::printf(" %.2f %.2f %.2f %.2f", m[row][0], m[row][1], m[row][2], m[row][3]);
  } else if (kind == "POSITION") {
    float p[3], q[4];
    igtl::PositionMessage* position = static_cast<igtl::PositionMessage*>(message.GetPointer());
    position->GetPosition(p);
    position->GetQuaternion(q);
    std::printf(" %.2f %.2f %.2f  %.2f %.2f %.2f %.2f", p[0], p[1], p[2], q[0], q[1], q[2], q[3]);
  } else if (kind == "IMAGE") {
    igtl::ImageMessage* image = static_cast<igtl::ImageMessage*>(message.GetPointer());
    int size[3];
    float spacing[3];
    image->GetDimensions(size);
    image->GetSpacing(spacing);
    const unsigned char* bytes = static_cast<const unsigned char*>(image->GetScalarPointer());
    unsigned long sum = 0;
    for (int k = 0; k < image->GetImageSize(); ++k) sum += bytes[k];
    std::printf(" %dx%dx%d %d spacing %.2f first %d %d %d sum %lu", size[0], size[1], size[2], image->GetNumComponents(),
                spacing[0], bytes[0], bytes[1], bytes[2], sum);
  } else if (kind == "POINT") {
    igtl::PointMessage* points = static_cast<igtl::PointMessage*>(message.GetPointer());
    for (int k = 0; k < points->GetNumberOfPointElement(); ++k) {
      igtl::PointElement::Pointer point;
      points->GetPointElement(k, point);
      float x, y, z;
      point->GetPosition(x, y, z);
      std::printf(" %s/%s %.2f %.2f %.2f r %.2f of %s", point->GetName(), point->GetGroupName(), x, y, z, point->GetRadius(),
                  point->GetOwner());
    }
  } else if (kind == "POLYDATA") {
    igtl::PolyDataMessage* data = static_cast<igtl::PolyDataMessage*>(message.GetPointer());
    igtlFloat32 first[3];
    data->GetPoints()->GetPoint(0, first);
    std::printf(" %d points %d vertices first %.2f %.2f %.2f attributes %d", data->GetPoints()->GetNumberOfPoints(),
                static_cast<int>(data->GetVertices()->GetNumberOfCells()), first[0], first[1], first[2],
                data->GetNumberOfAttributes());
    for (int k = 0; k < data->GetNumberOfAttributes(); ++k) {
      igtl::PolyDataAttribute* attribute = data->GetAttribute(k);
      igtlFloat32 value[16];
      attribute->GetNthData(0, value);
      std::printf(" %s %d x %d first %.2f %.2f %.2f", attribute->GetName(), static_cast<int>(attribute->GetSize()),
                  static_cast<int>(attribute->GetNumberOfComponents()), value[0], value[1], value[2]);
    }
  } else if (kind == "TDATA") {
    igtl::TrackingDataMessage* data = static_cast<igtl::TrackingDataMessage*>(message.GetPointer());
    for (int k = 0; k < data->GetNumberOfTrackingDataElements(); ++k) {
      igtl::TrackingDataElement::Pointer tool;
      data->GetTrackingDataElement(k, tool);
      igtl::Matrix4x4 m;
      tool->GetMatrix(m);
      std::printf(" %s/%d %.2f %.2f %.2f", tool->GetName(), tool->GetType(), m[0][3], m[1][3], m[2][3]);
    }
  } else if (kind == "RTS_TDATA") {
    std::printf(" %d", static_cast<igtl::RTSTrackingDataMessage*>(message.GetPointer())->GetStatus());
  } else if (kind == "STATUS") {
    igtl::StatusMessage* status = static_cast<igtl::StatusMessage*>(message.GetPointer());
    std::printf(" %d %s", status->GetCode(), status->GetStatusString());
    if (status->GetCode() == 19) {
      std::printf("\n");
      return "";
    }
  } else if (kind == "STRING") {
    std::printf(" %s", static_cast<igtl::StringMessage*>(message.GetPointer())->GetString());
  } else if (kind == "CAPABILITY") {
    const std::vector<std::string> kinds = static_cast<igtl::CapabilityMessage*>(message.GetPointer())->GetTypes();
    for (size_t k = 0; k < kinds.size(); ++k) std::printf(" %s", kinds[k].c_str());
  }
  std::printf("\n");
  std::fflush(stdout);
  return kind;
}

static void until(igtl::Socket* socket, const char* kind) {
  for (int k = 0; k < 1000; ++k) {
    const std::string found = next(socket);
    if (found == kind || found.empty()) return;
  }
}

static int ask(igtl::Socket* socket) {
  igtl::GetCapabilityMessage::Pointer capability = igtl::GetCapabilityMessage::New();
  send(socket, capability, "");
  until(socket, "CAPABILITY");
  igtl::GetStatusMessage::Pointer status = igtl::GetStatusMessage::New();
  send(socket, status, "");
  until(socket, "STATUS");
  igtl::StartTrackingDataMessage::Pointer start = igtl::StartTrackingDataMessage::New();
  start->SetResolution(1);
  start->SetCoordinateName("");
  send(socket, start, "Tracker");
  until(socket, "RTS_TDATA");
  until(socket, "TDATA");
  igtl::StopTrackingDataMessage::Pointer stop = igtl::StopTrackingDataMessage::New();
  send(socket, stop, "Tracker");
  until(socket, "RTS_TDATA");
  std::printf("done\n");
  return 0;
}

int main(int count, char** words) {
  if (count < 3) return 2;
  const std::string what = words[1];
  const int port = std::atoi(words[2]);
  if (what == "serve") return serve(port);
  igtl::ClientSocket::Pointer socket = igtl::ClientSocket::New();
  for (int k = 0; socket->ConnectToServer("127.0.0.1", port) != 0; ++k) {
    if (k > 200) return 3;
    igtl::Sleep(50);
  }
  std::printf("connected\n");
  std::fflush(stdout);
  if (what == "ask") return ask(socket);
  while (!next(socket).empty()) {
  }
  socket->CloseSocket();
  return 0;
}
