// From an image and the pose that it was taken at to the pose that the robot is to go to:
//     ./position model.onnx image.pgm < pose.txt    (4 x 4 numbers, row by row, in metres)
#include <onnxruntime_cxx_api.h>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <iostream>

int main(int argc, char** argv) try {
  if (argc != 3) throw std::runtime_error("usage: position model.onnx image.pgm < pose.txt");
  Ort::Env env(ORT_LOGGING_LEVEL_ERROR);
  Ort::Session session(env, argv[1], Ort::SessionOptions());  // once; the rest for every image
  const auto shape = session.GetInputTypeInfo(0).GetTensorTypeAndShapeInfo().GetShape();

  std::ifstream file(argv[2], std::ios::binary);
  std::string magic;
  int64_t width = 0, height = 0, most = 0;
  file >> magic >> width >> height >> most;
  std::vector<uint8_t> pixels(shape.at(0) * shape.at(1));
  file.ignore().read((char*)pixels.data(), pixels.size());
  if (!file || magic != "P5" || most != 255 || height != shape[0] || width != shape[1])
    throw std::runtime_error("the image must be a grey PGM of 8 bits, as large as in training");

  Ort::AllocatorWithDefaultOptions memory;
  const auto input = Ort::Value::CreateTensor<uint8_t>(memory.GetInfo(), pixels.data(),
                                                       pixels.size(), shape.data(), 2);
  const char *in[] = {"image"}, *out[] = {"is_recognised", "correction", "delta_p", "deviation"};
  const auto found = session.Run(Ort::RunOptions{nullptr}, in, &input, 1, out, 4);
  if (!*found[0].GetTensorData<bool>()) return std::puts("not recognised: do not move"), 2;
  const double *C = found[1].GetTensorData<double>(), *d = found[2].GetTensorData<double>();
  bool arrived = true;
  for (int k = 0; k < 6; ++k) arrived &= !(std::abs(d[k]) > found[3].GetTensorData<double>()[k]);
  if (arrived) return std::puts("arrived: nearer than is known"), 0;

  double T[16], goal[12] = {}, box[6];  // the pose, that times the correction; low and high x y z
  for (double& number : T) std::cin >> number;
  const auto text = session.GetModelMetadata().LookupCustomMetadataMapAllocated("workspace", memory);
  if (!std::cin || !text || std::sscanf(text.get(), "[%lf,%lf,%lf,%lf,%lf,%lf]", box, box + 1,
                                        box + 2, box + 3, box + 4, box + 5) < 6)
    throw std::runtime_error("the pose must be 16 numbers, and the model name a workspace");
  for (int k = 0; k < 12; ++k)
    for (int m = 0; m < 4; ++m) goal[k] += T[k / 4 * 4 + m] * C[4 * m + k % 4];
  for (int i = 0; i < 3; ++i)
    if (!(box[i] <= goal[4 * i + 3] && goal[4 * i + 3] <= box[3 + i]))
      return std::puts("outside the workspace: do not move"), 3;
  for (int k = 0; k < 12; ++k) std::printf("%.9f%c", goal[k], k % 4 == 3 ? '\n' : ' ');
} catch (const std::exception& error) {
  return std::fprintf(stderr, "position: %s\n", error.what()), 1;
}
