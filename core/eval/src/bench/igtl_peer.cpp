// The peer of `panoscope bench igtl`: a program on the OpenIGTLink library that sends back what it receives, CRC checked and packed anew.
// Argument: port.

#include <cstdlib>
#include <string>

#include <igtlClientSocket.h>
#include <igtlImageMessage.h>
#include <igtlMessageHeader.h>
#include <igtlServerSocket.h>
#include <igtlTimeStamp.h>
#include <igtlTransformMessage.h>

int main(int count, char** words) {
  igtl::ServerSocket::Pointer server = igtl::ServerSocket::New();
  if (count < 2 || server->CreateServer(std::atoi(words[1])) < 0) return 1;
  igtl::ClientSocket::Pointer client = server->WaitForConnection(20000);
  if (client.IsNull()) return 2;
  igtl::MessageHeader::Pointer header = igtl::MessageHeader::New();
  igtl::TransformMessage::Pointer transform = igtl::TransformMessage::New();
  igtl::ImageMessage::Pointer image = igtl::ImageMessage::New();
  for (;;) {
    header->InitPack();
    if (client->Receive(header->GetPackPointer(), header->GetPackSize()) != header->GetPackSize()) return 0;
    header->Unpack();
    igtl::TimeStamp::Pointer time = igtl::TimeStamp::New();
    header->GetTimeStamp(time);
    igtl::MessageBase* message = std::string(header->GetDeviceType()) == "IMAGE"
                                     ? static_cast<igtl::MessageBase*>(image.GetPointer())
                                     : static_cast<igtl::MessageBase*>(transform.GetPointer());
    message->SetMessageHeader(header);
    message->AllocatePack();
    client->Receive(message->GetPackBodyPointer(), message->GetPackBodySize());
    if (!(message->Unpack(1) & igtl::MessageHeader::UNPACK_BODY)) return 3;
    message->SetTimeStamp(time);
    message->Pack();
    if (!client->Send(message->GetPackPointer(), message->GetPackSize())) return 0;
  }
}
