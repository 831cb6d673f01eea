// The reference library as a referee: "read" prints the messages on its standard input and whether
// the library finds their checksums right; "write" writes one message of each type.

#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "igtlImageMessage.h"
#include "igtlMessageHeader.h"
#include "igtlNDArrayMessage.h"
#include "igtlPointMessage.h"
#include "igtlPolyDataMessage.h"
#include "igtlStatusMessage.h"
#include "igtlStringMessage.h"
#include "igtlTrackingDataMessage.h"
#include "igtlTransformMessage.h"

static void print_matrix(igtl::Matrix4x4& m) {
  for (int row = 0; row < 3; row++)
    for (int column = 0; column < 4; column++) printf(" %.9g", m[row][column]);
}

template <class Message>
static typename Message::Pointer receive(igtl::MessageHeader::Pointer header, bool* good) {
  typename Message::Pointer message = Message::New();
  message->SetMessageHeader(header);
  message->AllocatePack();
  size_t wanted = message->GetPackBodySize();
  size_t got = fread(message->GetPackBodyPointer(), 1, wanted, stdin);
  *good = got == wanted && (message->Unpack(1) & igtl::MessageHeader::UNPACK_BODY);
  return message;
}

static void read_messages() {
  for (;;) {
    igtl::MessageHeader::Pointer header = igtl::MessageHeader::New();
    header->InitPack();
    size_t size = header->GetPackSize();
    if (fread(header->GetPackPointer(), 1, size, stdin) != size) return;
    header->Unpack();
    igtl::TimeStamp::Pointer stamp = igtl::TimeStamp::New();
    header->GetTimeStamp(stamp);
    std::string type = header->GetDeviceType(), name = header->GetDeviceName();
    bool good = false;
    printf("%s %s %.9f", type.c_str(), name.c_str(), stamp->GetTimeStamp());
    if (type == "TRANSFORM") {
      igtl::TransformMessage::Pointer m = receive<igtl::TransformMessage>(header, &good);
      igtl::Matrix4x4 matrix;
      m->GetMatrix(matrix);
      print_matrix(matrix);
    } else if (type == "IMAGE") {
      igtl::ImageMessage::Pointer m = receive<igtl::ImageMessage>(header, &good);
      int n[3];
      float spacing[3];
      igtl::Matrix4x4 matrix;
      m->GetDimensions(n);
      m->GetSpacing(spacing);
      m->GetMatrix(matrix);
      for (int row = 0; row < 3; row++)
        for (int column = 0; column < 3; column++) matrix[row][column] *= spacing[column];
      printf(" %d %d %d %d %d", n[0], n[1], n[2], m->GetScalarType(), m->GetCoordinateSystem());
      print_matrix(matrix);
      unsigned char* voxels = (unsigned char*)m->GetScalarPointer();
      for (int k = 0; good && k < n[0] * n[1] * n[2]; k++) printf(" %d", voxels[k]);
    } else if (type == "STRING") {
      igtl::StringMessage::Pointer m = receive<igtl::StringMessage>(header, &good);
      printf(" %s", m->GetString());
    } else if (type == "STATUS") {
      igtl::StatusMessage::Pointer m = receive<igtl::StatusMessage>(header, &good);
      printf(" %d %s", m->GetCode(), m->GetStatusString());
    } else if (type == "POINT") {
      igtl::PointMessage::Pointer m = receive<igtl::PointMessage>(header, &good);
      for (int k = 0; k < m->GetNumberOfPointElement(); k++) {
        igtl::PointElement::Pointer point;
        igtlFloat32 p[3];
        m->GetPointElement(k, point);
        point->GetPosition(p);
        printf(" %.9g %.9g %.9g", p[0], p[1], p[2]);
      }
    } else if (type == "POLYDATA") {
      igtl::PolyDataMessage::Pointer m = receive<igtl::PolyDataMessage>(header, &good);
      igtl::PolyDataPointArray::Pointer points = m->GetPoints();
      igtl::PolyDataCellArray::Pointer lines = m->GetLines();
      if (good) {
        std::list<igtlUint32> cell;
        lines->GetCell(0, cell);
        printf(" %d %d", (int)lines->GetNumberOfCells(), (int)cell.size());
        for (int k = 0; k < points->GetNumberOfPoints(); k++) {
          igtlFloat32 p[3];
          points->GetPoint(k, p);
          printf(" %.9g %.9g %.9g", p[0], p[1], p[2]);
        }
      }
    } else if (type == "NDARRAY") {
      igtl::NDArrayMessage::Pointer m = receive<igtl::NDArrayMessage>(header, &good);
      if (good) {
        double* numbers = (double*)m->GetArray()->GetRawArray();
        printf(" %d", m->GetType());
        for (int k = 0; k < (int)(m->GetArray()->GetRawArraySize() / sizeof(double)); k++)
          printf(" %.17g", numbers[k]);
      }
    }
    printf(good ? " good\n" : " bad\n");
    fflush(stdout);
  }
}

static void write_message(igtl::MessageBase* message, const char* name) {
  igtl::TimeStamp::Pointer stamp = igtl::TimeStamp::New();
  stamp->SetTime(1700000000, 250000000);
  message->SetDeviceName(name);
  message->SetTimeStamp(stamp);
  message->Pack();
  fwrite(message->GetPackPointer(), 1, message->GetPackSize(), stdout);
}

static void write_messages() {
  // A turn by 90 deg about Z.
  igtl::Matrix4x4 matrix = {{0, -1, 0, 10}, {1, 0, 0, 20}, {0, 0, 1, 30}, {0, 0, 0, 1}};
  igtl::TransformMessage::Pointer transform = igtl::TransformMessage::New();
  transform->SetMatrix(matrix);
  write_message(transform, "ProbeToReference");

  igtl::ImageMessage::Pointer image = igtl::ImageMessage::New();
  float spacing[] = {1, 2, 4};
  image->SetDimensions(5, 4, 3);
  image->SetSpacing(spacing);
  image->SetScalarType(igtl::ImageMessage::TYPE_INT16);
  image->SetEndian(igtl::ImageMessage::ENDIAN_LITTLE);
  image->SetMatrix(matrix);
  image->AllocateScalars();
  for (int k = 0; k < 60; k++) ((short*)image->GetScalarPointer())[k] = (short)(k - 30);
  write_message(image, "Image_Probe");

  igtl::TrackingDataMessage::Pointer tracking = igtl::TrackingDataMessage::New();
  igtl::TrackingDataElement::Pointer tool = igtl::TrackingDataElement::New();
  tool->SetName("ProbeToReference");
  tool->SetType(igtl::TrackingDataElement::TYPE_6D);
  tool->SetMatrix(matrix);
  tracking->AddTrackingDataElement(tool);
  write_message(tracking, "Tracker");

  igtl::StringMessage::Pointer text = igtl::StringMessage::New();
  text->SetString("a text");
  write_message(text, "Text");

  igtl::StatusMessage::Pointer status = igtl::StatusMessage::New();
  status->SetCode(1);
  status->SetStatusString("all is well");
  write_message(status, "Status");

  igtl::PointMessage::Pointer points = igtl::PointMessage::New();
  igtl::PointElement::Pointer point = igtl::PointElement::New();
  point->SetPosition(1, 2, 3);
  points->AddPointElement(point);
  write_message(points, "Points");

  igtl::PolyDataMessage::Pointer poly = igtl::PolyDataMessage::New();
  igtl::PolyDataPointArray::Pointer vertices = igtl::PolyDataPointArray::New();
  vertices->AddPoint(1, 2, 3);
  vertices->AddPoint(4, 5, 6);
  igtl::PolyDataCellArray::Pointer lines = igtl::PolyDataCellArray::New();
  igtlUint32 line[] = {0, 1};
  lines->AddCell(2, line);
  poly->SetPoints(vertices);
  poly->SetLines(lines);
  write_message(poly, "Needle");

  igtl::NDArrayMessage::Pointer array = igtl::NDArrayMessage::New();
  igtl::Array<igtlFloat64> numbers;
  std::vector<igtlUint16> shape(2, 3);
  numbers.SetSize(shape);
  double values[] = {1, 2, 3, 2, 5, 6, 3, 6, 9};
  numbers.SetArray(values);
  array->SetArray(igtl::NDArrayMessage::TYPE_FLOAT64, &numbers);
  write_message(array, "Covariance");
}

int main(int argc, char* argv[]) {
  if (argc == 2 && !strcmp(argv[1], "read")) read_messages();
  if (argc == 2 && !strcmp(argv[1], "write")) write_messages();
  return 0;
}
